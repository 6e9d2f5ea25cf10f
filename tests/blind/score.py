"""Outcomes against labels: right, half, wrong or silent; intervals, calibration, bars."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]
SINGLE = {
    "force_sensor_bias", "force_sensor_misalignment", "frame_misalignment", "payload_error", "large_deflection",
    "base_compliance", "tool_compliance",
}  # fmt: skip
"""Effects that have one place only."""
SEPARABLE = 9.0
"""D above which a candidate of another name is told from the hidden effect: three standard deviations."""


def same(
    a: tuple[str, Mapping[str, Any]], b: tuple[str, Mapping[str, Any]], groups: Mapping[str, str]
) -> bool:
    """Whether two names are one: effect and place, or the same columns by structure."""
    if a[0] == b[0] and (a[0] in SINGLE or _plain(a[1]) == _plain(b[1])):
        return True
    first, second = groups.get(key(*a)), groups.get(key(*b))
    return bool(first) and first == second


def key(effect: str, where: Mapping[str, Any]) -> str:
    """Text that identifies effect and place."""
    return effect + "@" + ",".join(f"{k}={where[k]}" for k in sorted(where))


def _plain(where: Mapping[str, Any]) -> dict[str, Any]:
    return {k: sorted(v) if isinstance(v, list | tuple) else v for k, v in where.items()}


def outcome(
    verdict: str, sets: Sequence[Sequence[Any]], truth: Sequence[Any], groups: Mapping[str, str]
) -> str:
    """``right``, ``half`` (in an admissible set, or named as insufficient), ``wrong`` or ``silent``."""
    if verdict not in ("named", "ambiguous", "named_insufficient"):
        return "silent"
    matches = [len(s) == len(truth) and all(any(same(t, e, groups) for e in s) for t in truth) for s in sets]
    if verdict == "named" and matches and matches[0]:
        return "right"
    return "half" if any(matches) else "wrong"


def wilson(hits: float, n: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's interval of a share."""
    if n == 0:
        return 0.0, 1.0
    p, zz = hits / n, z * z / n
    middle = (p + zz / 2) / (1 + zz)
    half = z * math.sqrt(p * (1 - p) / n + zz / (4 * n)) / (1 + zz)
    return max(0.0, middle - half), min(1.0, middle + half)


def calibration(rows: Iterable[Row], bins: int = 5) -> tuple[float, int]:
    """Expected calibration error of the stated confidences, and how many there are."""
    stated = [(c, ok) for r in rows for c, ok in r["confidences"]]
    if not stated:
        return 0.0, 0
    stated.sort()
    parts = [stated[k * len(stated) // bins : (k + 1) * len(stated) // bins] for k in range(bins)]
    error = sum(abs(sum(c for c, _ in p) - sum(bool(ok) for _, ok in p)) for p in parts if p)
    return error / len(stated), len(stated)


Select = Callable[[Row], bool]


def share(rows: Iterable[Row], select: Select, good: Callable[[Row], float]) -> dict[str, Any]:
    """A share with its interval."""
    chosen = [r for r in rows if select(r)]
    hits = sum(good(r) for r in chosen)
    low, high = wilson(hits, len(chosen))
    return {"n": len(chosen), "share": hits / len(chosen) if chosen else None, "low": low, "high": high}


def points(row: Row) -> float:
    """1 for the right name and place, half for a correct admissible set."""
    return {"right": 1.0, "half": 0.5}.get(row["outcome"], 0.0)


def named(row: Row) -> float:
    """1 where one or several explanations have a name."""
    return float(row["verdict"] in ("named", "ambiguous"))


def listed(row: Row) -> float:
    """1 where the right explanation is named or in the set."""
    return float(row["outcome"] in ("right", "half"))


def limit(row: Row) -> float:
    """Points of a judge who knows the noise."""
    return float(row["limit"])


def spoke(row: Row) -> float:
    """1 where something is said to be missing."""
    return float(row["spoke"])


def noticed(row: Row) -> float:
    """1 where the stated sigma is called wrong."""
    return float(row["noticed"])


def of(kind: str, least: float = -math.inf, most: float = math.inf) -> Select:
    """Cases of a class whose effects have such sizes."""
    return lambda r: r["kind"] == kind and least <= r["wanted"] <= most


def apart(cases: Select) -> Select:
    """Those whose effects the data tell from all others."""
    return lambda r: cases(r) and (r["apart"] or 0.0) > SEPARABLE


def seen(cases: Select) -> Select:
    """Those that are also seen in four of five tables."""
    return lambda r: apart(cases)(r) and (r["needed"] or math.inf) <= r["wanted"]


def judged(cases: Select) -> Select:
    """Those that the judge has weighed."""
    return lambda r: cases(r) and r.get("limit") is not None


def stated(right: bool, freedom: int = 0) -> Select:
    """Cases whose sigma is stated right, or is not: of several loads a pose.

    Of one load what a pose's rows share is noise like any other, and none of the stated one.
    """
    return lambda r: (
        (r["stated"] == 1.0) is right and r["design"]["levels"] > 1 and r["design"]["freedom"] > freedom
    )


_25, _60 = of("one", 25.0, 25.0), of("one", 60.0, 60.0)
_TWO_60, _TWO_150 = of("two", 60.0, 60.0), of("two", 150.0)

BARS: tuple[tuple[str, Select, Callable[[Row], float]], ...] = (
    ("false alarms (nothing missing) <= 0.05", of("nothing"), spoke),
    ("false alarms (untestable) <= 0.05", of("untestable"), spoke),
    ("right name at lambda 10", of("one", 10.0, 10.0), points),
    ("right name at lambda 25 >= 0.85", _25, points),
    ("right name at lambda 60 >= 0.95", _60, points),
    ("right name at lambda 25, told apart by the data", apart(_25), points),
    ("right name at lambda 60, told apart by the data", apart(_60), points),
    ("right name at lambda 25, apart and seen in 80 %", seen(_25), points),
    ("right name at lambda 60, apart and seen in 80 %", seen(_60), points),
    ("right name at lambda 25, by a judge who knows the noise", judged(_25), limit),
    ("right name at lambda 60, by a judge who knows the noise", judged(_60), limit),
    ("right name at lambda 150", of("one", 150.0, 150.0), points),
    ("right name at lambda 600", of("one", 600.0, 600.0), points),
    ("bad pose", of("bad_pose"), points),
    ("wrong name outside the catalogue <= 0.05", of("outside"), named),
    ("wrong name outside the catalogue, told apart by the data", apart(of("outside")), named),
    ("two right at lambda 60 >= 0.85", _TWO_60, points),
    ("two right at lambda 150 and more >= 0.93", _TWO_150, points),
    ("two right at lambda 60, told apart by the data", apart(_TWO_60), points),
    ("two right at lambda 150 and more, told apart", apart(_TWO_150), points),
    ("two right at lambda 60, by a judge who is told one", judged(_TWO_60), limit),
    ("two right at lambda 150 and more, by such a judge", judged(_TWO_150), limit),
    ("confounded: named or in the set", of("confounded"), listed),
    ("sigma misstated: noticed", stated(False, 150), noticed),
    ("sigma stated right: called misstated", stated(True), noticed),
)
"""The promises of the diagnosis: of which cases, and what counts."""


def bars(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """The promises of the diagnosis, measured."""
    table = {title: share(rows, cases, good) for title, cases, good in BARS}
    closures = sorted(r["closure"] for r in rows if r["closure"] is not None and r["outcome"] == "right")
    if closures:
        table["closure of the oracle's, median >= 0.97"] = {
            "n": len(closures), "share": closures[len(closures) // 2], "low": closures[len(closures) // 10],
            "high": closures[-1],
        }  # fmt: skip
    error, n = calibration(rows)
    table["calibration error <= 0.08"] = {"n": n, "share": error if n else None, "low": 0.0, "high": 1.0}
    return table
