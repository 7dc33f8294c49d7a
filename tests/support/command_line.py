"""The command line as a process of its own: forked, where that can be, from one that has loaded the package."""

import atexit
import json
import os
import select
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

DEHYST = [sys.executable, "-c", "from dehyst.cli import main; main()"]
TIMEOUT = 600
# Commands write twelve significant digits: a number moves by this part of itself at most.
WRITTEN = 5e-12
# A line in: arguments, folder, environment, and files for both outputs of a command. A line out: its exit status.
# What commands import when they need it, the server has imported. A child ends as an interpreter does, but does not
# take the modules apart, which would copy all memory that it shares with the server.
_SERVER = """
import atexit, contextlib, gc, importlib, json, os, sys, threading
from dehyst.cli import main
for name in %r:
    with contextlib.suppress(ImportError):
        importlib.import_module(name)
gc.collect()
gc.freeze()

def end(status):
    if status is not None and not isinstance(status, int):
        print(status, file=sys.stderr)
        status = 1
    threading._shutdown()
    atexit._run_exitfuncs()
    gc.collect()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status or 0)

for line in sys.stdin:
    arguments, folder, environment, out, err = json.loads(line)
    child = os.fork()
    if child == 0:
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        for number, path in enumerate((os.devnull, out, err)):
            os.dup2(os.open(path, os.O_RDWR), number)
        sys.argv[1:] = arguments
        try:
            main()
        except SystemExit as ended:
            end(ended.code)
        except BaseException:
            sys.excepthook(*sys.exc_info())
            end(1)
        end(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
_IMPORTED = (
    *(f"dehyst.{room}" for room in ("report", "studies", "baselines", "trust", "virtual", "exports")),
    *(f"scipy.{part}" for part in ("optimize", "signal", "interpolate", "stats", "linalg", "sparse.linalg")),
    *("highspy", "h5py", "matplotlib.figure", "matplotlib.backends.backend_svg", "mpl_toolkits.mplot3d"),
)


@cache
def _server():
    server = subprocess.Popen(
        [sys.executable, "-c", _SERVER % (_IMPORTED,)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    atexit.register(server.communicate)
    return server


def _forked(arguments, folder):
    """Exit status, standard output and standard error of a child of the server."""
    server = _server()
    with tempfile.NamedTemporaryFile() as out, tempfile.NamedTemporaryFile() as err:
        request = arguments, str(folder), dict(os.environ), out.name, err.name
        server.stdin.write(json.dumps(request).encode() + b"\n")
        server.stdin.flush()
        assert select.select([server.stdout], [], [], TIMEOUT)[0], f"{arguments}: no end in {TIMEOUT} s"
        status = int(server.stdout.readline())
        return status, out.read().decode(), err.read().decode()


def run(*arguments, cwd=None):
    """Return exit status, standard output and standard error of a dehyst command."""
    words = list(map(str, arguments))
    if hasattr(os, "fork"):
        status, out, err = _forked(words, cwd or Path.cwd())
    else:
        done = subprocess.run([*DEHYST, *words], capture_output=True, text=True, cwd=cwd, timeout=TIMEOUT, check=False)
        status, out, err = done.returncode, done.stdout, done.stderr
    assert "Traceback" not in err, err
    return status, out, err


def run_as_process(*arguments, cwd=None, **options):
    """Status, standard output and standard error of a command as a process, which must not end in a traceback.

    With options of `subprocess.run`, it is not forked.
    """
    if not options:
        status, out, err = run(*map(os.fspath, arguments), cwd=cwd)
        assert "Exception ignored" not in err, err
        return status, out, err
    given = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "stdin": subprocess.DEVNULL,
        "timeout": 120,
        **options,
    }
    done = subprocess.run([*DEHYST, *map(os.fspath, arguments)], cwd=cwd, check=False, **given)
    err = (done.stderr or b"").decode()
    assert "Traceback" not in err and "Exception ignored" not in err, err
    return done.returncode, (done.stdout or b"").decode(), err
