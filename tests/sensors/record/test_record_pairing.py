"""Images of several streams, put together by their times."""

from __future__ import annotations

import numpy as np
import pytest

from sensors.record.sdk_frames import Pairing

PERIOD = 1000 / 30


def paired(events: list[tuple[str, int, float]]) -> tuple[list[tuple[int, int]], Pairing]:
    """Numbers of colour and depth images that were put together."""
    pairing = Pairing(["color", "depth"], PERIOD)
    sets = []
    for stream, number, time_ms in events:
        sets += list(pairing.add(stream, number, time_ms, number))
    sets += list(pairing.finish())
    return [(s["color"], s["depth"]) for s in sets], pairing


def stream(name: str, numbers: range, shift_ms: float = 0.0) -> list[tuple[str, int, float]]:
    return [(name, n, n * PERIOD + shift_ms) for n in numbers]


def by_time(*streams: list[tuple[str, int, float]]) -> list[tuple[str, int, float]]:
    return sorted((e for s in streams for e in s), key=lambda e: e[2])


@pytest.mark.parametrize("shift_ms", [-16.0, -5.0, 0.0, 0.4, 12.0, 16.0])
def test_streams_that_run_beside_each_other(shift_ms: float) -> None:
    found, pairing = paired(
        by_time(stream("color", range(50)), stream("depth", range(50), shift_ms))
    )
    assert found == [(n, n) for n in range(50)]
    assert all(c.lost == c.single == 0 for c in pairing.counts.values())


@pytest.mark.parametrize("late", [1, 3, 10])
def test_a_stream_whose_images_arrive_later(late: int) -> None:
    depth, color = stream("depth", range(50)), stream("color", range(50), 0.3)
    # Colour n arrives right after depth n + late.
    arrivals = [(e[1], e) for e in depth] + [(e[1] + late + 0.5, e) for e in color]
    events = [event for _, event in sorted(arrivals)]
    found, _ = paired(events)
    assert found == [(n, n) for n in range(50)]


def test_images_of_one_trigger_leave_at_once() -> None:
    pairing = Pairing(["color", "depth"], PERIOD)
    assert list(pairing.add("depth", 0, 10.0, "d")) == []
    assert list(pairing.add("color", 0, 10.4, "c")) == [{"color": "c", "depth": "d"}]


def test_lost_images_are_counted_and_never_replaced_by_others() -> None:
    depth = [e for e in stream("depth", range(40)) if e[1] not in (5, 6, 20)]
    color = [e for e in stream("color", range(40), 2.0) if e[1] != 30]
    found, pairing = paired(by_time(depth, color))
    assert found == [(n, n) for n in range(40) if n not in (5, 6, 20, 30)]
    assert pairing.counts["depth"].lost == 3 and pairing.counts["color"].lost == 1
    assert pairing.counts["color"].single == 3 and pairing.counts["depth"].single == 1
    assert pairing.counts["color"].arrived == 39 and pairing.counts["depth"].arrived == 37


def test_a_faster_stream_gives_its_nearest_images() -> None:
    color = [("color", n, n * PERIOD) for n in range(30)]
    depth = [("depth", n, n * PERIOD / 2) for n in range(60)]
    found, pairing = paired(by_time(color, depth))
    assert found == [(n, 2 * n) for n in range(30)]
    assert pairing.counts["depth"].single == 30


@pytest.mark.parametrize("seed", range(20))
def test_any_losses_and_delays(seed: int) -> None:
    """Whatever is lost and however late it comes, partners are of one time, in order, once each."""
    rng = np.random.default_rng(seed)
    arrivals: list[tuple[float, tuple[str, int, float]]] = []
    for name in ("color", "depth"):
        behind = rng.uniform(0, 80)
        clock = 0.0
        for number in range(100):
            if rng.random() < 0.15:
                continue
            clock = max(clock + 0.01, number * PERIOD + behind + rng.uniform(0, 30))
            arrivals.append((clock, (name, number, number * PERIOD + rng.uniform(-3, 3))))
    events = [e for _, e in sorted(arrivals)]
    found, pairing = paired(events)
    there = {name: {e[1] for e in events if e[0] == name} for name in ("color", "depth")}
    assert found == [(n, n) for n in sorted(there["color"] & there["depth"])]
    for name, count in pairing.counts.items():
        assert count.arrived == len(there[name])
        assert count.single == len(there[name]) - len(found)


def test_an_image_that_comes_twice() -> None:
    events = by_time(stream("color", range(4)), stream("depth", range(4)))
    found, pairing = paired([e for e in events for _ in (0, 1)])
    assert found == [(n, n) for n in range(4)]
    assert pairing.counts["color"].single == 4
