"""The command line in this process, and as a process of its own."""

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

import click
from click.testing import CliRunner

from dehyst.cli import main

DEHYST = [sys.executable, "-c", "from dehyst.cli import main; main()"]
TIMEOUT = 600
# Texts of parameters by their type.
TEXTS = {"columns": "time=2", "numbers": "1,2", "start": "bottom", "text": "70"}
OUTPUTS = {"-o", "--output", "--report", "--table"}
# Commands write twelve significant digits: the largest relative error of a written number.
WRITTEN = 5e-12


def run(*arguments, cwd=None, keep=False):
    """Return exit status, standard output and standard error of a dehyst command, run in this process.

    An output of an earlier command of the test is replaced, unless `keep`.
    """
    words = list(map(os.fspath, map(_text, arguments)))
    if not keep and OUTPUTS & {*words} and "--force" not in words:
        words.append("--force")
    with contextlib.chdir(cwd or Path.cwd()):
        done = CliRunner().invoke(main, words)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout, done.stderr


def commands(group=main, path=()):
    """Yield each command with its name."""
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


def sample_words(command, option=None, text=None):
    """Words of a command: its required arguments and options, and an `option` with a value other than its default."""
    words = []
    for each in command.params:
        if each is option or each.required or isinstance(each, click.Argument):
            texts = sample_texts(each) if text is None or each is not option else [text]
            words += texts if isinstance(each, click.Argument) else [_flag(each), *texts]
    return words


def _flag(option):
    return option.secondary_opts[0] if option.default is True else option.opts[-1]


def sample_texts(parameter):
    """Texts of a value of a parameter."""
    if getattr(parameter, "is_flag", False):
        return []
    if isinstance(parameter.type, click.Choice):
        return [parameter.type.choices[-1]]
    if isinstance(parameter.type, click.Path) and parameter.type.name not in TEXTS:
        return [f"absent-{parameter.name}{getattr(parameter.type, 'suffix', '')}"]
    return [TEXTS.get(parameter.type.name, "7")] * parameter.nargs if parameter.nargs > 0 else ["7"]


def _text(argument):
    return argument if isinstance(argument, str | os.PathLike) else str(argument)


def run_as_process(*arguments, cwd=None, **options):
    """Status, standard output and standard error of a command as a process, which must not end in a traceback."""
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL, "timeout": 120}
    done = subprocess.run([*DEHYST, *map(os.fspath, arguments)], cwd=cwd, check=False, **given | options)
    err = (done.stderr or b"").decode()
    assert "Traceback" not in err and "Exception ignored" not in err, err
    return done.returncode, (done.stdout or b"").decode(), err


def refused(*arguments, cwd=None):
    """Return the error of a command with status 2 as JSON values."""
    status, out, err = run(*arguments, "--json", cwd=cwd)
    assert status == 2, err
    return json.loads(out)["error"]


def result(*arguments, **options):
    """Return exit status and JSON result of a completed command."""
    status, out, err = run(*arguments, "--json", **options)
    assert status in (0, 1), err
    return status, json.loads(out)
