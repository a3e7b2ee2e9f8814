"""The colours on which photos agree, cell by cell of the table."""

import numpy as np

from std_toolkit.compiled import compiled


@compiled
def agree(  # type: ignore[no-untyped-def]
    samples, seen, gains, shares, better, close, continued, color, spread
) -> None:
    """Write the colour of each cell and its spread, which is left as it is where there is none.

    Args:
        samples: (V, N, 3) uint8 colours of the cells in the photos.
        seen: (V, N) photos that count.
        gains: (V, 3) exposures.
        shares: of the photos that agree, agree better beside an object, and may agree elsewhere.
        better, close, continued: of `TableModelSettings`.
        color, spread: (N, 3) and (N,) float32 results.
    """
    photos = len(samples)
    grey = np.empty(photos, np.float32)
    order = np.empty(photos, np.int64)
    for cell in range(len(color)):
        n = 0
        for v in range(photos):
            if not seen[v, cell]:
                continue
            value = np.float32(0)
            for c in range(3):
                value += samples[v, cell, c] / gains[v, c]
            value /= np.float32(3)
            # Photos by their brightness.
            at = n
            while at > 0 and grey[at - 1] > value:
                grey[at], order[at] = grey[at - 1], order[at - 1]
                at -= 1
            grey[at], order[at] = value, v
            n += 1
        if n == 0:
            continue
        first, last, width = _narrowest(grey, n, shares[0], 0, 0)
        start, end, third = _narrowest(grey, n, shares[1], 0, 0)
        if third * better / shares[1] < width / shares[0]:
            first, last, width = start, end, third
        start, end, other = _narrowest(grey, n, shares[2], first, last)
        doubtful = other < 2 * width + close and abs(grey[first] - grey[start]) > continued
        mean = np.zeros(3)
        for k in range(first, last):
            for c in range(3):
                mean[c] += samples[order[k], cell, c] / gains[order[k], c]
        mean /= last - first
        total = 0.0
        for k in range(first, last):
            off = 0.0
            for c in range(3):
                off = max(off, abs(samples[order[k], cell, c] / gains[order[k], c] - mean[c]))
            total += off
        for c in range(3):
            color[cell, c] = mean[c]
        if not doubtful:
            spread[cell] = 2 * total / (last - first)


@compiled
def _narrowest(grey, n, share, taken, until):  # type: ignore[no-untyped-def]
    """First, end and width of the share of n ascending values that differs least, without those
    from `taken` up to `until`; infinite if there is none."""
    k = max(1, int(np.ceil(share * n)))
    best, width = 0, np.inf
    for start in range(n - k + 1):
        if taken < start + k and start < until:
            continue
        here = grey[start + k - 1] - grey[start]
        if here < width:
            best, width = start, here
    return best, best + k, width


@compiled
def showing(  # type: ignore[no-untyped-def]
    samples, shown, gains, rows, columns, expected, bare, limits, steady
):
    """Which cells (N,) enough photos show in about the expected colours, and their means (N, 3).

    Args:
        samples: (V, h, w, 3) uint8 colours of all cells in the photos.
        shown: (V, h, w) photos that count.
        gains: (V, 3) exposures.
        rows, columns: (N,) of the cells.
        expected, bare: (N, 3) colours beside them, as they are and without shadows.
        limits: `continued`, `darkest`, `brightest`, `other_hue`, `continued_share` and
            `fewest_photos` of `TableModelSettings`.
        steady: largest spread of the photos about their mean.
    """
    count = len(rows)
    enough, mean = np.zeros(count, np.bool_), np.zeros((count, 3), np.float32)
    value = np.empty((len(samples), 3))
    for n in range(count):
        i, j = rows[n], columns[n]
        usual = max((bare[n, 0] + bare[n, 1] + bare[n, 2]) / 3, 1.0)
        there, fits = 0, 0
        total = np.zeros(3)
        for v in range(len(samples)):
            if not shown[v, i, j]:
                continue
            there += 1
            grey, off, hue = 0.0, 0.0, 0.0
            for c in range(3):
                value[fits, c] = samples[v, i, j, c] / gains[v, c]
                grey += value[fits, c] / 3
                off = max(off, abs(value[fits, c] - expected[n, c]))
            gain = grey / usual
            for c in range(3):
                hue = max(hue, abs(value[fits, c] - gain * bare[n, c]))
            if off < limits[0] and limits[1] < gain < limits[2] and hue < limits[3]:
                for c in range(3):
                    total[c] += value[fits, c]
                fits += 1
        if fits == 0 or fits < limits[5] or fits < limits[4] * there:
            continue
        total /= fits
        spread = 0.0
        for k in range(fits):
            off = 0.0
            for c in range(3):
                off = max(off, abs(value[k, c] - total[c]))
            spread += off / fits
        enough[n] = spread < steady
        for c in range(3):
            mean[n, c] = total[c]
    return enough, mean
