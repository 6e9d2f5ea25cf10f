"""Commands that look: the library of robots, the reduction of a model, the catalogue of effects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from symstiff.cli.output import check_targets, console, note, print_table, stages, write_json
from symstiff.errors import UserError
from symstiff.robot import library, load
from symstiff.robot.exact import Exact, parse_exact

if TYPE_CHECKING:
    from rich.console import Console

    from symstiff.discrepancy.apart.distinguish import Distinction
    from symstiff.effects.base import Effect, Where
    from symstiff.reduction import Reduction


def show_robots(json: str | None) -> None:
    """List the library."""
    check_targets({"--json": json})
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for column in ("robot", "title", "joints", "reach ≤ [m]"):
        table.add_column(column, justify="right" if column.startswith(("joints", "reach")) else "left")
    rows = []
    for name in library():
        robot = load(name)
        table.add_row(name, robot.title, f"{robot.dof} {robot.kinds}", f"{robot.reach:.2f}")
        rows.append(
            {
                "robot": name,
                "title": robot.title,
                "dof": robot.dof,
                "reach": robot.reach,
                "source": robot.source,
            }
        )
    write_json(json, rows)
    out = console(json)
    print_table(out, table, ["title"])
    out.print("sources: symstiff robots --json -")


def parse_fixed(text: str | None) -> dict[int, Exact]:
    """``q1=0,q4=pi/2`` as joint → exact value. Raises UserError."""
    fixed: dict[int, Exact] = {}
    for part in (text or "").split(","):
        if not part.strip():
            continue
        name, _, value = part.partition("=")
        joint = whole_number(name.strip().removeprefix("q"))
        if joint is None or not value.strip():
            raise UserError(f"--fixed {part.strip()!r}: write a joint and its value, e.g. q1=0 or q4=pi/2")
        if joint in fixed:
            raise UserError(f"--fixed: q{joint} stands there twice: give it one value")
        try:
            fixed[joint] = parse_exact(value.strip())
        except UserError as error:
            raise UserError(f"--fixed: q{joint}: {error}") from error
    return fixed


def whole_number(text: str) -> int | None:
    """The whole number that a text of plain digits stands for, None for any other text."""
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 9 else None


def show_reduction(
    robot: str,
    loads: str,
    measure: str,
    fixed: str | None,
    prefer: Sequence[str],
    avoid: Sequence[str],
    json: str | None,
) -> None:
    """Print the reduction stage by stage: what is numbers first, since closed forms of long arms take their time."""
    from symstiff.reduction import reduce
    from symstiff.reduction.closed_form import closed_form

    check_targets({"--json": json}, [robot])
    described, joints = load(robot), parse_fixed(fixed)
    out = console(json)
    with stages(out) as progress:
        progress("deriving and reducing")
        reduction = reduce(described, loads, measure, joints, prefer, avoid)
        if json is None:
            _print_numbers(out, reduction)
        progress("couplings in closed form")
        symbolic = closed_form(reduction)
    result = reduction.as_dict()
    result["couplings_symbolic"] = {e: {k: str(c) for k, c in row.items()} for e, row in symbolic.items()}
    write_json(json, result)
    if json is not None:  # a file is written before a word is said: a closed pipe ends the command
        _print_numbers(out, reduction)
    _print_couplings(out, symbolic)


def _print_numbers(out: Console, reduction: Reduction) -> None:
    print_stages(out, reduction)
    _print_groups(out, reduction)


def print_stages(out: Console, reduction: Reduction) -> None:
    """The seed's Table 1 for this robot and class."""
    from rich.table import Table

    from symstiff.reduction.reading import steps

    robot, e = reduction.robot, reduction.experiment
    table = Table(
        title=f"{robot.title or robot.name}: loads {e.loads}, measured {e.measure}", title_justify="left"
    )
    table.add_column("step")
    table.add_column("parameters", justify="right")
    table.add_column("what")
    for step, n, what in steps(reduction):
        table.add_row(step, str(n), what)
    print_table(out, table, ["what"])
    warn_of(out, reduction)


def warn_of(out: Console, reduction: Reduction) -> None:
    """Print what a robot's model could not hold, or what its file probably does not mean."""
    from symstiff.reduction.remarks import reduction_remarks

    for remark in reduction_remarks(reduction):
        note(out, remark, "warning")


def _print_groups(out: Console, reduction: Reduction) -> None:
    p = reduction.partition
    for label, names in (
        ("G1 identifiable", p.g1),
        ("G2 without influence", p.g2),
        ("G3 semi-identifiable", p.g3),
    ):
        _headed(out, label, f" ({len(names)}): {' '.join(names) or '–'}")
    for k, block in enumerate(p.blocks, start=1):
        kept = sum(name in p.kept for name in block)
        out.print(f"  coupled group {k}: {len(block)} parameters, {kept} independent")
    _headed(out, "identifiable set", f" ({p.rank}): {' '.join(p.kept)}")


def _headed(out: Console, head: str, text: str) -> None:
    from rich.text import Text

    out.print(Text.assemble((head, "bold"), text))


def _print_couplings(out: Console, couplings: dict[str, dict[str, Any]]) -> None:
    if not couplings:
        return
    from rich.table import Table

    from symstiff.reduction.reading import combination

    table = Table(
        title="couplings: column of the eliminated = Σ coefficient × column of the kept", title_justify="left"
    )
    table.add_column("eliminated")
    table.add_column("= Σ over kept")
    for eliminated, row in couplings.items():
        table.add_row(eliminated, combination(row))
    print_table(out, table, ["= Σ over kept"])


def show_targets(json: str | None) -> None:
    """List what can be emitted."""
    from symstiff.codegen.targets import TARGETS

    check_targets({"--json": json})
    write_json(json, [{"target": name, "writes": target.writes} for name, target in TARGETS.items()])
    out = console(json)
    for name, target in TARGETS.items():
        out.print(f"{name:10s} {target.writes}", soft_wrap=True)


def show_effects(robot: str, loads: str, measure: str, data: str, json: str | None) -> None:
    """The catalogue on a robot: what a class of experiments can tell of each effect from the complete model."""
    from symstiff.discrepancy.apart.distinguish import survey
    from symstiff.effects.places import named
    from symstiff.model import StiffnessModel
    from symstiff.reduction import reduce

    if data not in ("deflection", "absolute"):
        raise UserError(f"--data {data!r}: write deflection or absolute")
    check_targets({"--json": json}, [robot])
    reduction = reduce(load(robot), loads, measure)
    model = StiffnessModel.of(reduction)
    out = console(json)
    found: dict[str, list[tuple[Where, Distinction]]] = {}
    with stages(out) as progress:
        for effect, where, distinction in survey(model, data):
            progress(named(effect.identifier, where))
            found.setdefault(effect.identifier, []).append((where, distinction))
    title = f"{model.robot.title or model.robot.name}: loads {loads}, measured {measure}, {data} data"
    result = {"robot": model.robot.name, "loads": loads, "measure": measure, "data": data}
    write_json(json, {**result, "effects": _effects(found)})
    warn_of(out, reduction)
    _print_effects(out, title, found)


def _print_effects(out: Console, title: str, found: dict[str, list[tuple[Where, Distinction]]]) -> None:
    from rich.table import Table

    from symstiff.effects.registry import catalogue
    from symstiff.report.naming import places

    table = Table(title=title, title_justify="left")
    columns = ("effect", "where", "told from the complete model", "needs")
    for column in columns:
        table.add_column(column)
    for effect in catalogue().values():
        alike: dict[str, list[Where]] = {}
        for where, distinction in found.get(effect.identifier, []):
            alike.setdefault(_told(distinction), []).append(where)
        nowhere = "places depend on the data" if effect.places_in else "no such place on this robot"
        needs = " ".join(sorted(effect.needs)).replace("_", " ")
        for first, (told, wheres) in enumerate((alike or {nowhere: []}).items()):
            head = ("", "") if first else (effect.identifier, needs)
            table.add_row(head[0], places(wheres) or ("everywhere" if wheres else ""), told, head[1])
    print_table(out, table, columns[1:])


def _told(distinction: Distinction) -> str:
    if distinction.reason:
        return f"nothing: {distinction.reason}"
    total = len(distinction.parameters)
    of = f" of {total}" if distinction.gained < total else ""
    return f"{distinction.gained}{of} parameter{'s' if total > 1 else ''}"


def _effects(found: dict[str, list[tuple[Where, Distinction]]]) -> list[dict[str, Any]]:
    from symstiff.effects.registry import catalogue

    def entry(effect: Effect) -> dict[str, Any]:
        return {
            "effect": effect.identifier, "title": effect.title, "description": effect.description,
            "seen_in": sorted(effect.seen_in), "needs": sorted(effect.needs),
            "confused_with": list(effect.confused_with), "separated_by": effect.separated_by,
            "places": [
                {"where": dict(where), "parameters": list(d.parameters), "told": d.gained,
                 "inside": list(d.inside), "in_model": list(d.held), "reason": d.reason}
                for where, d in found.get(effect.identifier, [])
            ],
        }  # fmt: skip

    return [entry(effect) for effect in catalogue().values()]
