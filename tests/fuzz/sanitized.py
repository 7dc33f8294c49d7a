"""The package with its compiled modules built under the address and undefined-behaviour sanitizers.

    python tests/fuzz/sanitized.py build/sanitized tests/fuzz/compensators.py --seed 1 --count 1000

The first argument is the folder of the build, made when it is missing; the others are a Python program and its
arguments, run on the sanitized package. Needs cmake, nanobind, and gcc with libasan.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
# Undefined behaviour ends the process; conversions of numbers to int are no part of "undefined".
SANITIZE = ["-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all", "-g"]
OVERLAY = "DEHYST_SANITIZED"


def missing():
    """What is not installed that a sanitized build needs, or nothing."""
    for tool in ("cmake", "gcc", "g++"):
        if shutil.which(tool) is None:
            return tool
    nanobind = subprocess.run([sys.executable, "-m", "nanobind", "--cmake_dir"], capture_output=True, check=False)
    return "nanobind" if nanobind.returncode else runtime_missing()


def runtime_missing():
    """The sanitizers' library, if gcc does not find it."""
    return None if shutil.which("gcc") and Path(_library("libasan.so")).is_absolute() else "libasan"


def compiled(source, folder, **defined):
    """Compile the extension of a copy of the repository; return its files."""
    nanobind = _run([sys.executable, "-m", "nanobind", "--cmake_dir"]).strip()
    defined |= {"SKBUILD_PROJECT_NAME": "dehyst", "nanobind_DIR": nanobind, "Python_EXECUTABLE": sys.executable}
    _run(["cmake", "-S", source, "-B", folder, *(f"-D{name}={value}" for name, value in defined.items())])
    _run(["cmake", "--build", folder])
    return folder.glob("*.so")


def build(folder):
    """Compile the extension and lay it over the Python files; return the folder to import from."""
    folder = Path(folder).resolve()
    package, flags = folder / "overlay" / "dehyst", " ".join(SANITIZE)
    compilers = {"CMAKE_BUILD_TYPE": "None", "CMAKE_C_COMPILER": "gcc", "CMAKE_CXX_COMPILER": "g++"}
    compilers |= {"CMAKE_C_FLAGS": flags, "CMAKE_CXX_FLAGS": f"-O1 {flags}", "CMAKE_MODULE_LINKER_FLAGS": flags}
    modules = compiled(REPOSITORY, folder / "objects", **compilers)
    shutil.rmtree(package, ignore_errors=True)
    package.mkdir(parents=True)
    for source in (REPOSITORY / "src" / "dehyst").iterdir():
        if source.suffix != ".so" and source.name != "__pycache__":
            (package / source.name).symlink_to(source)
    for module in modules:
        shutil.copy(module, package)
    return folder / "overlay"


def environment(overlay):
    """Variables under which a Python process runs on the sanitized package."""
    return {
        **os.environ,
        OVERLAY: str(overlay),
        "LD_PRELOAD": " ".join(_library(name) for name in ("libasan.so", "libstdc++.so")),
        # Memory that the interpreter keeps to its end is no leak; a huge request must fail as without sanitizers.
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1:abort_on_error=1:malloc_context_size=4",
        "UBSAN_OPTIONS": "print_stacktrace=1:abort_on_error=1",
    }


def lay_over():
    """In a process with these variables: import dehyst from the overlay, not from where it is installed."""
    if overlay := os.environ.get(OVERLAY):
        sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in type(finder).__module__.lower()]
        sys.path.insert(0, overlay)


def _library(name):
    return _run(["gcc", f"-print-file-name={name}"]).strip()


def _run(command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{command[0]} failed:\n{done.stdout[-2000:]}{done.stderr[-4000:]}")
    return done.stdout


def main():
    overlay = build(sys.argv[1])
    command = [sys.executable, *sys.argv[2:]]
    sys.exit(subprocess.run(command, env=environment(overlay), check=False).returncode)


if __name__ == "__main__":
    main()
