"""Every option does what it says, and two generations with different options never claim the same hash."""

from __future__ import annotations

import ast
import itertools
import re
import zipfile
from collections.abc import Mapping
from io import BytesIO
from xml.etree import ElementTree

import casadi as ca
import pytest

from symstiff.codegen.compiler import Compiler
from symstiff.codegen.emit import emit_c
from symstiff.codegen.functions import Functions
from symstiff.codegen.generate import generate
from symstiff.codegen.options import CHOICES, Options
from symstiff.codegen.quoting import c_comment, markdown, pkgconfig, st_comment
from symstiff.codegen.targets import TARGETS
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, load_model
from symstiff.reduction import reduce
from symstiff.robot import from_table, load
from symstiff.robot.table import to_table
from tests.generated_c import STRICT, compiler, described, emitted, model, run, written

ROBOT = "scara"


def test_no_two_sets_of_options_share_a_hash():
    m = model(ROBOT)
    values = dict(m.values)
    sets = [("c",), ("c", "casadi"), *((("c", t) if t != "c" else ("c", "st")) for t in TARGETS)]
    options = {
        Options(p, layout, targets)
        for p, layout, targets in itertools.product(CHOICES["precision"], CHOICES["layout"], sets)
    }
    hashes = {o.model_hash(m.structure_hash, values) for o in options}
    assert len(hashes) == len(options) > 30


def test_values_and_structure_are_part_of_the_hash():
    m, o = model(ROBOT), Options()
    base = o.model_hash(m.structure_hash, dict(m.values))
    assert o.model_hash(m.structure_hash, {n: 2 * v for n, v in m.values.items()}) != base
    assert o.model_hash("0" * 64, dict(m.values)) != base


def own(target: str, precision: str = "double") -> dict[str, bytes]:
    """What one target writes."""
    if target == "c":
        return emitted(ROBOT, precision, ("c",))
    options = Options(precision=precision, targets=("c", target))
    return TARGETS[target].emitter()(Functions(model(ROBOT)), options)


@pytest.mark.parametrize("target", [t for t in TARGETS if t not in ("c", "casadi")])
def test_every_target_writes_files_of_its_own(target):
    assert own(target)
    assert not set(own(target)) & set(own("c"))


def test_no_robot_is_called_like_a_part_of_anothers_library():
    """Sources and headers of ``scara`` that would be those of a robot ``scara_…`` too, and include guards with them."""
    files = {f for target in TARGETS for f in own(target)}
    ends = {f.removeprefix(ROBOT) for f in files if f.startswith(f"{ROBOT}.")}
    names = {f.removesuffix(e) for f in files for e in ends if f.startswith(f"{ROBOT}_") and f.endswith(e)}
    assert len(names) >= 4
    table = to_table(load(ROBOT))
    for name in names:
        with pytest.raises(UserError, match=f"name: '{name}' is what files of a robot 'scara' are called"):
            from_table(table | {"name": name}, "robot.toml")
    assert from_table(table | {"name": "scara_rls_robot"}, "robot.toml").name == "scara_rls_robot"


@pytest.mark.parametrize("target", [t for t in TARGETS if t != "casadi"])
def test_precision_changes_what_every_target_writes(target):
    double, single = own(target, "double"), own(target, "float")
    assert double.keys() == single.keys()
    same = {n for n in double if double[n] == single[n]}
    assert same <= {f"{ROBOT}.params", f"{ROBOT}.pc.in", "CMakeLists.txt", "MISRA.md"}


def test_single_precision_targets_contain_no_double():
    files = emitted(ROBOT, "float", ("c", "params", "rls", "cpp"))
    for name in (
        "scara.c",
        "scara_batch.c",
        "scara.h",
        "scara_params.c",
        "scara_rls.c",
        "scara_selftest.c",
        "scara.hpp",
    ):
        code = re.sub(r"/\*.*?\*/|//[^\n]*", "", files[name].decode(), flags=re.DOTALL)
        assert not re.search(r"\bdouble\b", code), name
        numbers = re.findall(r"(?<![\w.])\d+\.\d+(?:e[-+]?\d+)?\w*", code)
        assert all(n.endswith("f") for n in numbers), name


@pytest.mark.parametrize("cc", ["gcc", "clang"])
@pytest.mark.parametrize("precision", ["double", "float"])
def test_all_sources_compile_together_strictly(tmp_path, cc, precision):
    folder = written(tmp_path, ROBOT, precision, ("c", "params", "rls"))
    for source in sorted(folder.glob("scara*.c")):
        run(compiler(cc), *STRICT, "-O1", "-c", "-I.", source.name, "-o", "x.o", cwd=folder)


def test_the_sources_of_targets_join_the_library_that_cmake_builds():
    text = emitted(ROBOT, "double", ("c", "params", "rls", "cpp"))["CMakeLists.txt"].decode()
    for name in ("scara_params.c", "scara_rls.c", "scara_params.h", "scara_rls.h", "scara.hpp"):
        assert name in text
    plain = emitted(ROBOT, "double", ("c",))["CMakeLists.txt"].decode()
    assert "params" not in plain.replace("scara_batch", "")


@pytest.mark.parametrize("target", ["params", "rls", "cpp", "python"])
def test_targets_over_c_need_it(target):
    with pytest.raises(UserError, match="add c"):
        Options(targets=(target,))


def test_unknown_choices_are_named():
    with pytest.raises(UserError, match="precision: unknown 'half': use double or float"):
        Options(precision="half")
    with pytest.raises(UserError, match="targets: unknown 'rust': use c, casadi"):
        Options(targets=("rust",))


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
def test_every_target_takes_a_model_that_depends_on_the_moment(target, tmp_path):
    """Time and temperature: in the C struct, in inputs, in the simulation's time."""
    m = model("kuka_kr270")
    entry = find("thermal_drift")
    where = entry.places(m.robot)[0]
    shape = entry.shapes(m.robot, where, Scales(context={"time": 3600.0, "temperature": 10.0}))[0]
    grown = m.with_effect(EffectInstance("thermal_drift", where, shape))
    options = Options(targets=("c", target) if target != "c" else ("c",))
    emit = TARGETS[target].emitter()
    plain, warm = (readable(emit(Functions(x), options)) for x in (m, grown))
    assert "temperature" not in plain
    # the others take the C struct as it is, or CasADi's vector "context"
    assert ("temperature" in warm) == (target not in ("cpp", "rls", "casadi"))
    if target == "casadi":
        (tmp_path / "f.casadi").write_bytes(emit(Functions(grown), options)["kuka_kr270_deflection.casadi"])
        function = ca.Function.load(str(tmp_path / "f.casadi"))
        assert function.name_in() == ["p", "q", "w", "context"]


def readable(emitted: Mapping[str, bytes]) -> str:
    """The texts that were emitted; of an archive what it tells of itself."""
    texts = []
    for name, content in emitted.items():
        if name.endswith(".fmu"):
            content = zipfile.ZipFile(BytesIO(content)).read("modelDescription.xml")
        texts.append(content.decode())
    return "\n".join(texts)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["t", "te", "ma", "test_main", "e", "n"])
def test_a_name_that_begins_names_of_other_files_is_no_obstacle(name, tmp_path):
    compiler()
    options = Options(targets=("c", "cpp", "params", "rls"))
    made = generate(described("planar2r", name=name), tmp_path / "code", options)
    assert made.verification.compiled
    (tmp_path / "use.cpp").write_text(f'#include "{name}.hpp"\nint main() {{ return 0; }}\n')
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    run(compiler("g++"), *flags, f"-I{tmp_path / 'code'}", tmp_path / "use.cpp")


TITLES = [
    'arm /* old */ // C:\\Users\\new """ \'\'\' (* st *) *) <b> & "quoted" `code` \\',
    "@PROJECT_NAME@ ${x} # ???/ %d {{ n }} {% x %}",
    "*/ int x; /*/ é √ |",
    "arm /* old",
    'ends in three quotes """',
]


@pytest.mark.slow
@pytest.mark.parametrize("title", TITLES)
def test_whatever_a_title_says_every_target_stays_what_it_is(title, tmp_path):
    compiler()
    folder = tmp_path / "code"
    m = described("planar2r", title=title, source=title)
    made = generate(m, folder, Options(targets=tuple(t for t in TARGETS if t != "casadi")))
    assert made.verification.compiled
    run("gcc", *STRICT, f"-I{folder}", "-c", folder / "fuzz_planar2r.c", "-o", tmp_path / "fuzz.o")
    (tmp_path / "use.cpp").write_text('#include "planar2r.hpp"\nint main() { return 0; }\n')
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    run(compiler("g++"), *flags, f"-I{folder}", tmp_path / "use.cpp")
    names: dict = {}
    for node in ast.parse((folder / "planar2r.py").read_text()).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "TITLE":
            names["TITLE"] = ast.literal_eval(node.value)
    assert names == {"TITLE": title}
    for version in (2, 3):
        with zipfile.ZipFile(folder / f"planar2r_fmi{version}.fmu") as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            code = archive.read(f"sources/planar2r_fmi{version}.c").decode()
        assert root.get("description").startswith(f"Stiffness model of {title}. Results hold for loads")
        assert "/*" not in code[2 : code.index("*/")]
    assert after_comment((folder / "FB_planar2r.st").read_text()).startswith("FUNCTION_BLOCK FB_planar2r")
    assert not set("@$#\\") & set((folder / "planar2r.pc.in").read_text().splitlines()[5])
    assert load_model(folder / "model.toml").robot.title == title


def after_comment(text: str) -> str:
    """What follows a comment in which comments nest."""
    depth, at = 0, 0
    while depth or not at:
        pair = text[at : at + 2]
        depth += (pair == "(*") - (pair == "*)")
        at += 2 if pair in ("(*", "*)") else 1
    return text[at:].lstrip()


def test_quoted_text_is_spaced_and_escaped():
    assert c_comment("*/*/ /*/ ??/") == "* / * / / * / ? ?/"
    assert st_comment("(*)(*") == "( * )( *"
    assert markdown("a_b*c`<d>") == r"a\_b\*c\`\<d\>"
    assert c_comment("???/") == "? ? ?/"
    assert pkgconfig("a@b$c#d") == "a b c d"


@pytest.mark.parametrize("loads", ["gravity", "force", "wrench"])
def test_the_header_says_which_loads_a_reduced_model_holds_for(loads):
    functions = Functions(model("planar2r", loads))
    header = emit_c(functions, Options(targets=("c",)))["planar2r.h"].decode()
    text = " ".join(header.replace("\n *", "").split())
    reduced = f'hold for loads of the class "{loads}" only' in text and "K may be indefinite" in text
    assert reduced == (loads != "wrench")
    assert "holds only as far as these parameters tell it" not in text


def test_the_header_says_that_measured_positions_do_not_tell_rotations():
    functions = Functions(StiffnessModel.of(reduce(load("planar2r"), "force", "position")))
    header = emit_c(functions, Options(targets=("c",)))["planar2r.h"].decode()
    text = " ".join(header.replace("\n *", "").split())
    assert (
        "The rotation (drx, dry, drz), which compensate and stiffness take too, holds only as far as" in text
    )


@pytest.mark.parametrize("target", ["st", "python", "cpp", "fmi2", "fmi3"])
@pytest.mark.parametrize("limited", [True, False])
def test_every_target_that_stands_alone_says_where_a_reduced_model_holds(target, limited):
    asked = ("force", "position", {2: 0.5}) if limited else ("wrench", "pose", {})
    functions = Functions(StiffnessModel.of(reduce(load("scara"), *asked)))
    (content,) = TARGETS[target].emitter()(functions, Options(targets=("c", target))).values()
    if target.startswith("fmi"):
        with zipfile.ZipFile(BytesIO(content)) as unit:
            content = ElementTree.fromstring(unit.read("modelDescription.xml")).get("description").encode()
    text = " ".join(content.decode().replace("//", "").split())
    for said in (
        "joints that stand still, q2 = 0.5 (rad, m), and hold there alone",
        'hold for loads of the class "force" only: any force at the tool centre point, no moment.',
        "translations hold. The rotation, which the compensated joint command takes too, holds only as far as",
    ):
        assert (said in text) == limited


@pytest.mark.parametrize("version", [2, 3])
def test_without_compilation_no_target_runs_a_compiler(version, tmp_path, monkeypatch):
    def compiled(*_, **__):
        raise AssertionError("a compiler ran")

    monkeypatch.setattr(Compiler, "run", compiled)
    options = Options(targets=("c", f"fmi{version}"))
    generate(model(ROBOT), tmp_path / "out", options, compile_c=False)
    unit = zipfile.ZipFile(tmp_path / "out" / f"{ROBOT}_fmi{version}.fmu").namelist()
    assert f"sources/{ROBOT}.c" in unit
    assert not [name for name in unit if name.startswith("binaries/")]


@pytest.mark.slow
@pytest.mark.parametrize("target", ["c", "st"])
def test_the_meaning_of_default_parameters_is_told(target, tmp_path):
    known = StiffnessModel.of(reduce(load("ur10"), "gravity"))
    assert any(known.values.values())
    known.save(tmp_path / "model.toml")
    of_file = "what the robot file knows; others are zero until they are identified."
    other = dict.fromkeys(known.parameters, 1e-07)
    gap = known.with_effect(EffectInstance("backlash", {"joint": 2}, {"width": 5.0}))
    for m, said in (
        (known, of_file),
        (load_model(tmp_path / "model.toml"), of_file),
        (known.with_values(dict.fromkeys(known.parameters, 0.0)), of_file),
        (gap, of_file),
        (known.with_values(other), "given with the model."),
        (gap.with_values({**known.values, "backlash_2_gap": 1e-4}), "given with the model."),
        (known.with_values(other, dict.fromkeys(other, 1e-9)), "identified from measurements."),
    ):
        files = TARGETS[target].emitter()(Functions(m), Options(targets=(target,)))
        told = [f for f, text in files.items() if b"Default parameters: " in text]
        assert told == {"c": ["ur10.h", "README.md"], "st": ["FB_ur10.st"]}[target]
        for file in told:
            assert f"Default parameters: {said}" in files[file].decode()


@pytest.mark.slow
def test_angles_without_a_name_and_with_a_negative_cosine_are_compiled(tmp_path):
    rows = [(0.4, 2.5, 0.3, 0), (0.5, -3.0, 0.1, 2.2), (0.3, 1.0, 0.2, -2.0)]
    joints = [dict(zip(("a", "alpha", "d", "theta"), row, strict=True)) for row in rows]
    odd = from_table({"format": 1, "name": "odd", "joint": joints})
    made = generate(StiffnessModel.of(reduce(odd)), tmp_path / "odd", Options(targets=tuple(TARGETS)))
    assert not re.search(r"--\d", (tmp_path / "odd" / "odd.c").read_text())
    if made.verification.compiler is None:
        pytest.skip("no C compiler: the rest of the test needs one")
    assert made.verification.compiled
    assert made.verification.max_relative_error < 1e-12


@pytest.mark.parametrize(("name", "unit"), [("ur10", "N*m"), ("scara", "N")])
def test_the_header_tells_the_shape_of_a_law_with_units(name: str, unit: str) -> None:
    gear = EffectInstance(
        "nonlinear_stiffness", {"joint": 3}, {"load": 1350.0, "knee": 1.0, "tapered_mass": 500.0}
    )
    grown = StiffnessModel.of(reduce(load(name), "force", "position")).with_effect(gear)
    header = emit_c(Functions(grown), Options())[f"{name}.h"].decode()
    assert f"reference load 1350 {unit}, two slopes that meet at it, under a tapering arm of 500 kg" in header


def test_every_parameter_of_effects_has_a_meaning_of_its_own() -> None:
    heavy = heavy_arm()
    gap = {"width": 20.0}
    for effect in (
        EffectInstance("backlash", {"joint": 1}, gap),
        EffectInstance("backlash", {"joint": 2}, {**gap, "weights": 0.0}),
        EffectInstance("transmission_error", {"joint": 2, "harmonics": [3]}),
        EffectInstance("geometric_error", {"link": 1}),
        EffectInstance("payload_error", {"load": "payload"}),
    ):
        heavy = heavy.with_effect(effect)
    header = emit_c(Functions(heavy), Options())[f"{heavy.robot.name}.h"].decode()
    told = {n: re.search(rf"{n}; /\* (.*) \*/", header)[1] for n in (e.name for e in heavy.effect_parameters)}
    assert len(set(told.values())) == len(told)
    assert told["backlash_2_gap"].endswith("turning over within +- 20 N*m, links' weight left out")
    assert "weight" not in told["backlash_1_gap"]
    assert told["transmission_error_2_a3"].endswith(": of sin(3*q2)")
    assert told["transmission_error_2_b3"].endswith(": of cos(3*q2)")
    assert told["geometric_error_1_ry"].endswith(
        ": turned about y of the link's elastic frame, x along the beam"
    )
    assert told["payload_error_payload_mz"].endswith(": first moment along z of frame 2")


def heavy_arm() -> StiffnessModel:
    """A planar arm whose first link has a mass."""
    table = to_table(load("planar2r"))
    joints = [dict(j) for j in table["joint"]]
    joints[0]["link"] = {**joints[0].get("link", {}), "mass": 12.0, "com": [-0.2, 0.0, 0.0]}
    return StiffnessModel.of(reduce(from_table(table | {"joint": joints}, "arm.toml"), "wrench"))


def test_a_temperature_is_told_in_ascii() -> None:
    warm = {"temperature": 8.0, "reference": 22.0}
    drift = EffectInstance("thermal_drift", {"measurement": "frame"}, warm)
    grown = StiffnessModel.of(reduce(load("planar2r"), "force", "position")).with_effect(drift)
    header = emit_c(Functions(grown), Options())["planar2r.h"].decode()
    assert "from 22 degC" in header
