"""Stand-ins for C compilers: they compile the core of an export, which contains no model, once for each command.

As a program: compiler_cache.py FOLDER COMPILER ARGUMENT... does what the compiler does with the arguments, but takes
the object of ``dehyst.c`` from the folder, if this compiler made it there with the same flags from the same text.
"""

import hashlib
import os
import sys

COMPILERS = ("cc", "gcc", "clang", "arm-none-eabi-gcc")
_SOURCE, _HEADERS = "dehyst.c", ("dehyst.h", "dehyst_model.h", "dehyst_config.h")
# These options ask for something else than an object or a program, or for headers in other folders.
_OTHERWISE = ("-E", "-S", "-M", "-I", "-x", "-T", "-fsyntax-only", "-save-temps", "@")


def install(programs, folder):
    """Put stand-ins for the installed compilers into the folder `programs`; `folder` keeps their objects."""
    import shutil

    for name in COMPILERS:
        if compiler := shutil.which(name):
            program = programs / name
            program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -IS "{__file__}" "{folder}" "{compiler}" "$@"\n')
            program.chmod(0o755)


def _read(path):
    # The import of pathlib takes as long as the compilation of a small file.
    with open(path, "rb") as file:  # noqa: PTH123
        return file.read()


def _compiled(kept, compiler, flags):
    """Whether the compiler filled the folder `kept` with its files of the core, without a message."""
    import shutil
    import subprocess
    import tempfile
    from pathlib import Path

    work = Path(tempfile.mkdtemp(dir=Path(kept).parent))
    for name in (_SOURCE, *_HEADERS):
        shutil.copyfile(name, work / name)
    done = subprocess.run([compiler, *flags, "-c", _SOURCE], cwd=work, capture_output=True, check=False)
    for name in (_SOURCE, *_HEADERS):
        (work / name).unlink()
    silent = not (done.returncode or done.stdout or done.stderr)
    if silent:
        try:
            work.rename(kept)
        except OSError:
            shutil.rmtree(work)  # Another process has compiled it first.
    else:
        shutil.rmtree(work)
    return silent


def _take(kept, output):
    """Copy the object, under its name on the command line, and the other files that the compiler wrote."""
    for name in os.listdir(kept):  # noqa: PTH208
        to = output if output and name.endswith(".o") else name
        with open(to, "wb") as file:  # noqa: PTH123
            file.write(_read(f"{kept}/{name}"))


def _without_the_core(folder, compiler, words):
    """Arguments for the work that remains when the core's object exists; None if nothing remains."""
    if (
        words.count(_SOURCE) != 1
        or any(word.startswith(_OTHERWISE) for word in words)
        or not all(os.access(name, 0) for name in _HEADERS)
    ):
        return words
    rest, output = list(words), None
    if "-o" in rest[:-1]:
        at = rest.index("-o")
        output = rest[at + 1]
        del rest[at : at + 2]
    flags = [word for word in rest if word.startswith("-") and word != "-c" and not word.startswith("-l")]
    files = [word for word in rest if not word.startswith("-")]
    if not all(file.endswith((".c", ".o")) for file in files):
        return words
    texts = [_read(name) for name in (_SOURCE, *_HEADERS)]
    kept = f"{folder}/{hashlib.sha256(repr((compiler, flags, texts)).encode()).hexdigest()}"
    if not os.access(kept, 0) and not _compiled(kept, compiler, flags):
        return words
    if "-c" not in words:
        return [f"{kept}/dehyst.o" if word == _SOURCE else word for word in words]
    _take(kept, output)
    return [word for word in words if word != _SOURCE] if len(files) > 1 else None


def main():
    """Compile."""
    folder, compiler, *words = sys.argv[1:]
    left = _without_the_core(folder, compiler, words)
    if left is not None:
        os.execv(compiler, [compiler, *left])


if __name__ == "__main__":
    main()
