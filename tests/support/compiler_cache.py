"""Stand-ins for C compilers: they compile the core of an export, which contains no model, once for each command.

As a program: compiler_cache.py FOLDER COMPILER ARGUMENT... does what the compiler does with the arguments, but takes
the object of ``dehyst.c`` from the folder, if this compiler made it there with the same flags from the same text.
"""

import hashlib
import os
import sys

COMPILERS = ("cc", "gcc", "clang", "arm-none-eabi-gcc")
_SOURCE, _HEADERS = "dehyst.c", ("dehyst.h", "dehyst_model.h", "dehyst_config.h")
# These options ask for something else than an object, or for headers in other folders.
_OTHERWISE = ("-E", "-S", "-M", "-I", "-x", "-save-temps", "@")


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


def _compile(kept, compiler, flags):
    """Compile the core into the file `kept`, where a message of the compiler does not end the process."""
    import subprocess

    # Another process may compile it too.
    own = f"{kept}.{os.getpid()}"
    done = subprocess.run([compiler, *flags, _SOURCE, "-o", own], capture_output=True, check=False)
    if done.returncode or done.stdout or done.stderr:
        sys.stdout.buffer.write(done.stdout)
        sys.stderr.buffer.write(done.stderr)
        sys.exit(done.returncode or "the core is compiled with a message")
    os.replace(own, kept)  # noqa: PTH105


def main():
    """Compile."""
    folder, compiler, *words = sys.argv[1:]
    at = words.index("-o") if "-o" in words[:-1] else len(words)
    flags, output = words[:at] + words[at + 2 :], (*words[at + 1 : at + 2], "dehyst.o")[0]
    files = [word for word in flags if not word.startswith("-")]
    if files != [_SOURCE] or "-c" not in flags or any(word.startswith(_OTHERWISE) for word in flags):
        os.execv(compiler, [compiler, *words])
    texts = [_read(name) for name in (_SOURCE, *_HEADERS)]
    kept = f"{folder}/{hashlib.sha256(repr((compiler, flags, texts)).encode()).hexdigest()}"
    if not os.access(kept, 0):
        _compile(kept, compiler, [flag for flag in flags if flag != _SOURCE])
    with open(output, "wb") as file:  # noqa: PTH123
        file.write(_read(kept))


if __name__ == "__main__":
    main()
