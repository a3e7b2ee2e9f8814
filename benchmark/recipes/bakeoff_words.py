"""The verdict of a bake-off in words."""

from collections.abc import Sequence

from benchmark.recipes.bakeoff_verdict import RAW, Ranking, Verdict

MATERIALS = {
    "specular+transparent": "transparent and specular objects",
    "transparent": "transparent objects",
    "specular": "specular objects",
    "diffuse": "opaque objects",
    "all": "all objects",
}
REGIONS = {
    "harm_opaque": "on opaque objects",
    "harm_background": "on the background",
    "harm_band": "around glass and metal",
}
_MIXED = "swindrnet"  # of which std-restore takes a part by default


def conclusion(verdict: Verdict) -> str:
    """The conclusion in one line of words."""
    ranking = verdict.rankings.get(verdict.main)
    if ranking is None and verdict.left_out:
        return "These frames do not decide: no method answered every frame."
    if ranking is None:
        return "These frames do not decide: no frame has a pixel of an object to compare."
    where = MATERIALS[verdict.main]
    if verdict.kind == "undecided":
        return f"These frames do not decide{_undecided(verdict, ranking)}"
    best = verdict.method
    error = f"RMSE {ranking.errors[best].text(1e3, ' mm')} on {where}"
    ahead = ""
    if ranking.behind:
        second, behind = next(iter(ranking.behind.items()))
        ahead = f", {behind.text(1e3, ' mm')} less than {_called(second)}, the next best"
    if verdict.kind == "sensor":
        return f"Use none of these methods: the sensor's own depth is better, {error}{ahead}."
    cost = f" It takes {verdict.costs[best]}." if best in verdict.costs else ""
    if verdict.kind == "use":
        alone = " (`std-restore --where everywhere`)" if best == _MIXED else ""
        return f"Use {best}{alone}: {error}{ahead}. {_harmless(verdict, best)}{cost}"
    whole = verdict.whole
    text = (
        f"{best} is the best on {where}, but not for whole frames. Use its depth within masks of "
        f"these objects alone: {error}{ahead}. Of the depth that the sensor had right it breaks "
        f"{_breaks(verdict, best)}.{cost}"
    )
    if best == _MIXED:
        text += " `std-restore --where glass` takes it where glass or metal is found."
    if whole is None:
        return f"{text} No other method breaks less."
    if whole.decided and whole.best == RAW:
        return f"{text} No method that breaks less is better than the sensor's own depth."
    if whole.decided:
        shown = whole.errors[whole.best].text(1e3, " mm")
        return f"{text} For whole frames use {whole.best}: RMSE {shown}."
    return f"{text} For whole frames these do not decide between {_listed(whole.tied)}."


def _undecided(verdict: Verdict, ranking: Ranking) -> str:
    where, unit = MATERIALS[verdict.main], verdict.unit
    if len(ranking.errors) < 2:
        return ": fewer than two methods answered every frame."
    names = [_called(name) for name in ranking.tied]
    second = ranking.tied[1]
    text = (
        f" between {_listed(names)}: on {where} RMSE is "
        f"{ranking.errors[ranking.best].text(1e3, ' mm')} and "
        f"{ranking.errors[second].text(1e3, ' mm')}, a difference of "
        f"{ranking.behind[second].text(1e3, ' mm')} over {counted(ranking.units, unit)}."
    )
    if RAW in ranking.tied:
        text += " No method is shown to be better than the sensor's own depth."
    if ranking.units < ranking.needed:
        return (
            f"{text} A difference between {len(ranking.errors)} methods can be shown with "
            f"{ranking.needed} {unit}s or more."
        )
    return f"{text} Record more scenes, or compare fewer methods."


def counted(number: int, what: str) -> str:
    """
    >>> counted(1, "view"), counted(2, "view")
    ('1 view', '2 views')
    """
    return f"{number} {what}{'' if number == 1 else 's'}"


def _called(method: str) -> str:
    return "the sensor's own depth" if method == RAW else method


def _listed(names: Sequence[str]) -> str:
    """
    >>> _listed(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _breaks(verdict: Verdict, method: str) -> str:
    parts = [
        f"{value.text(100, ' %')} {REGIONS[region]}"
        for region, value in verdict.broken(method).items()
    ]
    return _listed(parts)


def _harmless(verdict: Verdict, method: str) -> str:
    harms = verdict.harms.get(method, {})
    if not harms:
        return "What it breaks these frames do not tell: around the objects they have no truth."
    worst = max(harms, key=lambda region: harms[region].mean)
    text = f"It breaks at most {harms[worst].text(100, ' %')} of depth that the sensor had right"
    text += f" ({REGIONS[worst]})."
    if "harm_background" not in harms:
        text += " What it does to the background these frames do not tell."
    return text


def by_material(verdict: Verdict) -> list[str]:
    """A sentence for each kind of material that the frames show."""
    lines = []
    for name, ranking in verdict.rankings.items():
        many = f"{counted(ranking.frames, 'frame')}, {counted(ranking.units, verdict.unit)}"
        start = f"{MATERIALS[name].capitalize()} ({many}): "
        if not ranking.decided:
            lines.append(f"{start}undecided between {_listed([_called(t) for t in ranking.tied])}.")
            continue
        shown = ranking.errors[ranking.best].text(1e3, " mm")
        lines.append(f"{start}{_called(ranking.best)}, RMSE {shown}.")
    return lines
