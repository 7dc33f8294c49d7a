"""The core alone, as a C developer builds it: its laws by ctest, under sanitizers too, and found by find_package."""

import shutil
import subprocess

import places
import pytest

USER = """
cmake_minimum_required(VERSION 3.18)
project(user C)
find_package(dehyst 0.1 REQUIRED)
add_executable(user main.c)
target_link_libraries(user PRIVATE dehyst::dehyst)
"""
PROGRAM = """
#include <dehyst_model.h>
int main(void)
{
    dehyst_real knot[2] = {0, 1}, value[2] = {0, 2}, slope[1];
    return dehyst_curve_tabulate(2, knot, value, slope) != DEHYST_OK || slope[0] != 2;
}
"""


def run(*command):
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    return done.stdout


def build(source, folder, *options, target="all"):
    run("cmake", "-S", source, "-B", folder, *options)
    run("cmake", "--build", folder, "--target", target)


@pytest.fixture(autouse=True)
def tools():
    for tool in ("cmake", "ctest", "cc"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed: the core cannot be built alone")


def test_another_cmake_project_finds_the_core(tmp_path):
    build(places.CORE, tmp_path / "core", target="dehyst")
    run("cmake", "--install", tmp_path / "core", "--prefix", tmp_path / "installed")
    (tmp_path / "CMakeLists.txt").write_text(USER)
    (tmp_path / "main.c").write_text(PROGRAM)
    build(tmp_path, tmp_path / "user", f"-DCMAKE_PREFIX_PATH={tmp_path / 'installed'}")
    run(tmp_path / "user" / "user")
