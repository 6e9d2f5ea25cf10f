"""What the poses that would decide reach, and under which loads, in words."""

from __future__ import annotations

from dataclasses import replace
from html import unescape

import pytest

from symstiff.cli.diagnose import _more
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.report.html import render
from symstiff.report.words import sentence
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured
from tests.test_report import CODE


@pytest.fixture(scope="module")
def named() -> Finding:
    return diagnose(Task(load(ROBOT), measured(HARDENING)))


@pytest.mark.parametrize(
    ("separations", "sentence_end", "file"),
    [
        (
            (2.0, 5.22),
            "they reach a separation of 5.22, which may not decide (9 does): repeated readings, more poses, other "
            "loads or another way to measure would.",
            ", decide.csv (poses that reach a separation of 5.22, which may not decide (9 does)), "
            "taken.csv (those of the data)",
        ),
        (
            (8.0, 143.2),
            "they reach a separation of 143 (9 decides).",
            ", decide.csv (poses that reach a separation of 143 (9 decides)), taken.csv (those of the data)",
        ),
        (
            (),
            "No pose tells them apart under these loads: others may, unless both are the same to the tool.",
            "",
        ),
    ],
)
def test_what_the_deciding_poses_reach_is_said_alike_everywhere(
    named: Finding, separations: tuple[float, ...], sentence_end: str, file: str
) -> None:
    poses = [
        {"pose": f"decide{k}", "q": {"q1[deg]": 1.0}, "separation": s} for k, s in enumerate(separations)
    ]
    record = {"poses": poses, "loads": [], "branches": [], "points": ["tcp"]}
    finding = replace(named, verdict="ambiguous")
    assert sentence(finding, record).endswith(sentence_end)
    assert _more({"decide": record}) == file
    page = unescape(render(finding, {"code": CODE, "decide": record}, []))
    assert sentence_end in page
    last = sentence_end.rpartition(": ")[2].removeprefix("they ")
    assert " ".join(page[page.index("What would decide") :].split()).count(last.rstrip(".")) == 1
    told = file.removeprefix(", decide.csv (poses that ").removesuffix("), taken.csv (those of the data)")
    assert f"These poses {told}" in page or not poses


@pytest.mark.parametrize(("fz", "loaded"), [(-50.0, True), (0.0, False)])
def test_loads_of_deciding_poses_are_spoken_of_where_there_are_any(
    named: Finding, fz: float, loaded: bool
) -> None:
    poses = [{"pose": "decide1", "q": {"q1[deg]": 1.0}, "separation": 3.0}]
    record = {"poses": poses, "loads": [{"fx[N]": 0.0, "fz[N]": fz}], "branches": [], "points": ["tcp"]}
    finding = replace(named, verdict="ambiguous")
    page = unescape(render(finding, {"code": CODE, "decide": record}, []))
    told = page[page.index("What would decide") :]
    assert ("holds the poses and loads that" in sentence(finding, record)) == loaded
    for text in ("each under every load below", "Loads of every pose", "smaller loads for laws"):
        assert (text in told) == loaded
