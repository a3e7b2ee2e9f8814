"""Category-level poses as the paper prints them, in the names and units of this benchmark."""

from __future__ import annotations

import pandas as pd

from benchmark.published.load import SPLIT_OF, SUBSETS_OF, published_rows

_PERCENT = "_pct"


def published_poses() -> pd.DataFrame:
    """Poses by method and split.

    Returns:
        The columns split, subset, method, training_data, table (where it is printed), and iou25,
        ..., 10deg10cm (shares); NaN where nothing is printed. In the order of print. By the
        protocol `paper`.
    """
    rows = published_rows()
    rows = rows[(rows["task"] == "category_pose") & rows["dataset"].isin(SPLIT_OF)]
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for row in rows.itertuples():
        for subset in SUBSETS_OF[row.subset]:
            key = (SPLIT_OF[row.dataset], subset, row.method, row.training_data, row.table)
            metric = row.metric.removesuffix(_PERCENT)
            found.setdefault(key, {})[metric] = float(row.value) / 100
    keys = ("split", "subset", "method", "training_data", "table")
    return pd.DataFrame(
        [dict(zip(keys, key, strict=True)) | figures for key, figures in found.items()]
    )
