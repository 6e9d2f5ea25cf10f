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


def bars(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """The promises of the diagnosis, measured."""

    def one(lam: float) -> Select:
        return lambda r: r["kind"] == "one" and r["wanted"] == lam

    def apart(lam: float) -> Select:
        return lambda r: one(lam)(r) and (r["apart"] or 0.0) > SEPARABLE

    def testable(lam: float) -> Select:
        return lambda r: apart(lam)(r) and (r["needed"] or math.inf) <= lam

    def judged(cases: Select) -> Select:
        return lambda r: cases(r) and r.get("limit") is not None

    def limit(row: Row) -> float:
        return float(row["limit"])

    def two(least: float, most: float = math.inf) -> Select:
        return lambda r: r["kind"] == "two" and least <= r["wanted"] <= most

    def two_apart(least: float, most: float = math.inf) -> Select:
        return lambda r: two(least, most)(r) and (r["apart"] or 0.0) > SEPARABLE

    def of(kind: str) -> Select:
        return lambda r: r["kind"] == kind

    def repeated(row: Row) -> bool:
        """Of one load a pose, what a pose's rows share is noise like any other, and none of the stated one."""
        return bool(row["design"]["levels"] > 1)

    def spoke(row: Row) -> float:
        return float(row["spoke"])

    table = {
        "false alarms (nothing missing) <= 0.05": share(rows, of("nothing"), spoke),
        "false alarms (untestable) <= 0.05": share(rows, of("untestable"), spoke),
        "right name at lambda 10": share(rows, one(10.0), points),
        "right name at lambda 25 >= 0.85": share(rows, one(25.0), points),
        "right name at lambda 60 >= 0.95": share(rows, one(60.0), points),
        "right name at lambda 25, told apart by the data": share(rows, apart(25.0), points),
        "right name at lambda 60, told apart by the data": share(rows, apart(60.0), points),
        "right name at lambda 25, apart and seen in 80 %": share(rows, testable(25.0), points),
        "right name at lambda 60, apart and seen in 80 %": share(rows, testable(60.0), points),
        "right name at lambda 25, by a judge who knows the noise": share(rows, judged(one(25.0)), limit),
        "right name at lambda 60, by a judge who knows the noise": share(rows, judged(one(60.0)), limit),
        "right name at lambda 150": share(rows, one(150.0), points),
        "right name at lambda 600": share(rows, one(600.0), points),
        "bad pose": share(rows, lambda r: r["kind"] == "bad_pose", points),
        "wrong name outside the catalogue <= 0.05": share(
            rows, lambda r: r["kind"] == "outside", lambda r: float(r["verdict"] in ("named", "ambiguous"))
        ),
        "wrong name outside the catalogue, told apart by the data": share(
            rows,
            lambda r: r["kind"] == "outside" and (r["apart"] or 0.0) > SEPARABLE,
            lambda r: float(r["verdict"] in ("named", "ambiguous")),
        ),
        "two right at lambda 60 >= 0.85": share(rows, two(60.0, 60.0), points),
        "two right at lambda 150 and more >= 0.93": share(rows, two(150.0), points),
        "two right at lambda 60, told apart by the data": share(rows, two_apart(60.0, 60.0), points),
        "two right at lambda 150 and more, told apart": share(rows, two_apart(150.0), points),
        "two right at lambda 60, by a judge who is told one": share(rows, judged(two(60.0, 60.0)), limit),
        "two right at lambda 150 and more, by such a judge": share(rows, judged(two(150.0)), limit),
        "confounded: named or in the set": share(
            rows, lambda r: r["kind"] == "confounded", lambda r: float(r["outcome"] in ("right", "half"))
        ),
        "sigma misstated: noticed": share(
            rows,
            lambda r: r["stated"] != 1.0 and r["design"]["freedom"] > 150 and repeated(r),
            lambda r: float(r["noticed"]),
        ),
        "sigma stated right: called misstated": share(
            rows, lambda r: r["stated"] == 1.0 and repeated(r), lambda r: float(r["noticed"])
        ),
    }  # fmt: skip
    closures = sorted(r["closure"] for r in rows if r["closure"] is not None and r["outcome"] == "right")
    if closures:
        table["closure of the oracle's, median >= 0.97"] = {
            "n": len(closures), "share": closures[len(closures) // 2], "low": closures[len(closures) // 10],
            "high": closures[-1],
        }  # fmt: skip
    error, n = calibration(rows)
    table["calibration error <= 0.08"] = {"n": n, "share": error if n else None, "low": 0.0, "high": 1.0}
    return table
