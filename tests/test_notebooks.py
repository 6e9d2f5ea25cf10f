"""The notebooks run from a clean kernel, and are committed with their outputs."""

from __future__ import annotations

import importlib.util
import re
from functools import cache

import pytest

from tests.notebooks import executed, notebooks

nbformat = pytest.importorskip("nbformat", reason="nbformat is missing: pip install symstiff[test]")
RUNNABLE = all(importlib.util.find_spec(name) for name in ("nbclient", "ipykernel"))
needs_kernel = pytest.mark.skipif(
    not RUNNABLE, reason="nbclient or ipykernel is missing: pip install symstiff[test]"
)
PLANAR, CALIBRATION = "01_planar_2r_to_kr270.ipynb", "02_calibration.ipynb"
_COMPILER_DEPENDS = ("C agrees", "no C compiler here")
_TAG = re.compile(r"<style.*?</style>|<[^>]+>", re.DOTALL)
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
each = pytest.mark.parametrize("path", notebooks(), ids=lambda path: path.name)


@cache
def _run(name):
    return executed(next(path for path in notebooks() if path.name == name))


def _texts(node):
    """Everything that the cells show, as text; what a cell prints may come in pieces, in the middle of a line."""
    shown = []
    for cell in node.cells:
        for output in cell.get("outputs", []):
            shown.append(output.get("text", ""))
            shown += [f"\n{value}\n" for kind, value in output.get("data", {}).items() if "image" not in kind]
        shown.append("\n")
    return "".join(shown)


def _pictures(node):
    return sum("image/png" in o.get("data", {}) for c in node.cells for o in c.get("outputs", []))


def _rms(text, label):
    return float(re.search(rf"{label}.*?rms +([0-9.]+) mm", text).group(1))


def _table1(text):
    return [int(n) for n in re.findall(r"<td[^>]*>(?:original|M\d)</td><td[^>]*>(\d+)</td>", text)]


def test_there_are_two_notebooks():
    assert [path.name for path in notebooks()] == [PLANAR, CALIBRATION]


@each
def test_committed_notebooks_have_outputs_of_one_run_and_no_errors(path):
    cells = [c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"]
    assert [c.execution_count for c in cells] == list(range(1, len(cells) + 1))
    assert cells[-1].outputs
    kinds = {(o.output_type, o.get("name")) for c in cells for o in c.outputs}
    assert ("error", None) not in kinds
    assert ("stream", "stderr") not in kinds


@each
def test_committed_notebooks_are_small_and_speak_of_no_machine(path):
    text = path.read_text(encoding="utf-8")
    assert path.stat().st_size < 400_000
    outputs = _texts(nbformat.read(path, as_version=4))
    assert not re.search(
        r"/(home|root|work|tmp|usr|Users|venv)/|[A-Z]:\\\\|site-packages|0x[0-9a-f]{8}", outputs
    )
    assert set(nbformat.read(path, as_version=4).metadata) == {"kernelspec", "language_info"}
    assert "execution_state" not in text


@pytest.mark.slow
@needs_kernel
def test_the_first_notebook_finds_what_it_tells():
    node = _run(PLANAR)
    text = _texts(node)
    assert "the same as by hand: True" in text
    assert "equal to the columns of M1: True" in text
    assert "A(k22): True" in text
    assert "CasADi agrees to 1e-12 of it: True" in text
    assert "C agrees to 1e-12 of it: True" in text or "no C compiler here" in text
    assert _table1(text)[-6:] == [258, 153, 62, 56, 46, 26]
    assert _rms(text, "complete model") < 0.05 * _rms(text, "joint compliances only")
    assert _rms(text, "joint compliances only") < _rms(text, "without compensation")
    assert _pictures(node) == 1


@pytest.mark.slow
@needs_kernel
def test_the_second_notebook_finds_what_it_tells():
    node = _run(CALIBRATION)
    text = _texts(node)
    assert _rms(text, "complete ") < 0.2 * _rms(text, "joints only ")
    assert _rms(text, "it never saw") < 0.2 * _rms(text, "joints only ")
    assert "predicts the identified deflections: True" in text
    assert 'id="T_table2"' in text
    assert _pictures(node) == 1


@needs_kernel
@pytest.mark.parametrize("name", [PLANAR, CALIBRATION])
def test_committed_outputs_are_those_of_today(name):
    """Numbers may differ in their last digit from machine to machine; words may not."""
    committed, today = (_shown(node) for node in (nbformat.read(_path(name), as_version=4), _run(name)))
    assert _NUMBER.sub("#", committed).split() == _NUMBER.sub("#", today).split()
    pairs = zip(_NUMBER.findall(committed), _NUMBER.findall(today), strict=True)
    assert [(old, new) for old, new in pairs if not _agree(old, new)] == []


def _path(name):
    return next(p for p in notebooks() if p.name == name)


def _shown(node):
    """Streams and tables as text, in the order of the cells."""
    outputs = [o for c in node.cells for o in c.get("outputs", [])]
    texts = [o.get("text") or _TAG.sub(" ", o.get("data", {}).get("text/html", "")) for o in outputs]
    lines = [line for text in texts for line in text.splitlines()]
    return "\n".join(line for line in lines if not line.startswith(_COMPILER_DEPENDS))


def _agree(old, new):
    """Whether two numbers as printed differ by no more than one in the last digit, or are rounding both."""
    last = min(_last_digit(old), _last_digit(new))
    return abs(float(old) - float(new)) <= 1.01 * last or max(abs(float(old)), abs(float(new))) < 1e-10


def _last_digit(number):
    mantissa, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
