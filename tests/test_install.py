"""Consumers build against the installed files, found by CMake and by pkg-config."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.generated_c import compiler, model, poses, run, written

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="written for Unix-like systems")
ROBOT = "scara"
TARGETS = ("c", "params", "rls", "cpp")
CMAKE = """cmake_minimum_required(VERSION 3.16)
project(consumer LANGUAGES C CXX)
set(CMAKE_CXX_STANDARD 17)
find_package(scara {version} REQUIRED)
add_executable(consumer main.c)
target_link_libraries(consumer PRIVATE scara::scara)
add_executable(consumer_cpp main.cpp)
target_link_libraries(consumer_cpp PRIVATE scara::scara)
"""
MAIN_C = """#include <scara.h>
#include <scara_params.h>
#include <scara_rls.h>
#include <stdio.h>
int main(void)
{{
    const double q[4] = {{ {q} }};
    const double w[6] = {{ {w} }};
    double dt[6], many[6];
    int i;
    static scara_rls_t state;
    scara_params_t p;
    if (scara_deflection(&scara_default_params, q, w, dt)
        || scara_deflection_batch(&scara_default_params, 1, q, w, many)
        || scara_selftest(NULL) || scara_rls_init(&state, &scara_default_params, 0.1, 1.0, 10.0)
        || scara_params_read("", 0, &p, NULL) != SCARA_E_PARAMS_MISSING) {{
        return 1;
    }}
    for (i = 0; i < 6; ++i) printf("%.17g ", dt[i]);
    return 0;
}}
"""
MAIN_CPP = """#include <scara.hpp>
int main()
{
    scara::twist dt;
    return scara::deflection(scara::default_params(), {}, {}, dt) == scara::status::ok ? 0 : 1;
}
"""


@pytest.fixture(scope="module", params=["static", "shared"])
def installed(request, tmp_path_factory) -> tuple[Path, str]:
    """Prefix with the installed files; the sources are gone."""
    compiler("cmake")
    compiler()
    base = tmp_path_factory.mktemp(request.param)
    source = written(base / "source", ROBOT, "double", TARGETS)
    shared = "ON" if request.param == "shared" else "OFF"
    options = [f"-DBUILD_SHARED_LIBS={shared}", f"-DCMAKE_INSTALL_PREFIX={base / 'prefix'}"]
    run("cmake", "-S", source, "-B", base / "build", *options)
    run("cmake", "--build", base / "build")
    run("ctest", "--test-dir", base / "build", "--output-on-failure")
    run("cmake", "--install", base / "build")
    source.rename(base / "moved")
    (base / "build").rename(base / "build-moved")
    return base / "prefix", request.param


@pytest.fixture
def consumer(tmp_path) -> Path:
    q, w = poses(ROBOT, 1)
    text = MAIN_C.format(q=", ".join(map(repr, q[0].tolist())), w=", ".join(map(repr, w[0].tolist())))
    (tmp_path / "main.c").write_text(text)
    (tmp_path / "main.cpp").write_text(MAIN_CPP)
    return tmp_path


def right(output: str) -> bool:
    q, w = poses(ROBOT, 1)
    wanted = model(ROBOT).deflection(q, w)[0]
    return bool(
        np.allclose(np.array(output.split(), float), wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())
    )


def test_find_package_finds_the_installed_library(installed, consumer):
    prefix, _ = installed
    (consumer / "CMakeLists.txt").write_text(CMAKE.format(version="0.1"))
    run("cmake", "-S", consumer, "-B", consumer / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", consumer / "build")
    assert right(run(consumer / "build" / "consumer"))
    run(consumer / "build" / "consumer_cpp")


def test_another_version_is_refused(installed, consumer):
    prefix, _ = installed
    (consumer / "CMakeLists.txt").write_text(CMAKE.format(version="99.0"))
    done = subprocess.run(
        ["cmake", "-S", consumer, "-B", consumer / "build", f"-DCMAKE_PREFIX_PATH={prefix}"],
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0
    assert "99.0" in done.stderr


def test_pkg_config_finds_the_installed_library(installed, consumer):
    prefix, kind = installed
    compiler("pkg-config")
    folder = next(prefix.rglob("scara.pc")).parent
    environment = os.environ | {"PKG_CONFIG_PATH": str(folder)}
    command = ["pkg-config", *(["--static"] if kind == "static" else []), "--cflags", "--libs", "scara"]
    flags = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()
    run("gcc", "-std=c99", "main.c", *flags, f"-Wl,-rpath,{folder.parent}", "-o", "consumer", cwd=consumer)
    assert right(run(consumer / "consumer"))
    said = run("pkg-config", "--validate", folder / "scara.pc") if kind == "static" else ""
    assert not said


def test_the_installation_holds_headers_library_and_nothing_of_the_tests(installed):
    prefix, kind = installed
    names = {p.name for p in prefix.rglob("*") if p.is_file()}
    ending = "so" if sys.platform == "linux" else "dylib"
    assert {
        "scara.h",
        "scara_params.h",
        "scara_rls.h",
        "scara.hpp",
        "scara.pc",
        "scara-config.cmake",
    } <= names
    assert ("libscara.a" if kind == "static" else f"libscara.{ending}") in names
    assert not {n for n in names if "test" in n or n == "main.c"}
    for path in prefix.rglob("*"):
        if path.suffix in (".cmake", ".h", ".hpp"):
            assert str(prefix.parent / "source") not in path.read_text()
