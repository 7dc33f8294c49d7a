"""What every test shares: signals, Hypothesis without a stopwatch, compilers that remember, and FMUs."""

import os
import resource
import signal
from collections import Counter
from dataclasses import replace
from pathlib import Path

import compiler_cache
import profiles  # noqa: F401 - loads the profile of Hypothesis
import pytest
from workbench_page import chromium

from dehyst._threads import one_thread

# A runner in the background may ignore Ctrl-C and a hang-up; processes of the tests must not.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """One more worker than processors: some tests wait for clocks and answers of real processes."""
    given = os.environ.get("PYTEST_XDIST_AUTO_NUM_WORKERS")
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return int(given) if given else processors + 1


def processor_time():
    """Return the CPU time [s] of this process and of the children that it waited for."""
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item):
    item.stash[BEGAN] = processor_time()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item):
    """State what a test cost: on a busy machine its duration tells little."""
    try:
        return (yield)
    finally:
        item.user_properties.append((CPU, f"{processor_time() - item.stash[BEGAN]:.3f}"))


def pytest_terminal_summary(terminalreporter):
    """Print where the processor time went, by file and by test, of a run whose results are kept (`--junitxml`)."""
    if not terminalreporter.config.option.xmlpath:
        return
    tests, files = Counter(), Counter()
    for report in (each for reports in terminalreporter.stats.values() for each in reports):
        # A warning is in these lists too: it has a test's name and is no report of one.
        if getattr(report, "when", None) == "teardown":
            tests[report.nodeid] += float(dict(report.user_properties).get(CPU, 0))
    for test, seconds in tests.items():
        files[test.partition("::")[0]] += seconds
    terminalreporter.section(f"processor time: {tests.total() / 60:.1f} minutes")
    for name, seconds in files.most_common(25) + tests.most_common(25):
        terminalreporter.write_line(f"{seconds:8.1f} s  {name}")


BEGAN, CPU = pytest.StashKey(), "cpu_s"


@pytest.fixture(scope="session", autouse=True)
def blas_on_one_thread():
    """Oracles solve too, and spinning BLAS threads take the processors from what is being tested."""
    with one_thread():
        yield


@pytest.fixture(scope="session", autouse=True)
def compilers_that_remember(tmp_path_factory):
    """The core of exports is compiled once for a command and a content, for all workers of a run."""
    own, worker = tmp_path_factory.getbasetemp(), os.environ.get("PYTEST_XDIST_WORKER")
    programs, kept = own / "compilers", (own.parent if worker else own) / "compiled"
    programs.mkdir()
    kept.mkdir(exist_ok=True)
    compiler_cache.install(programs, kept)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", str(programs), prepend=os.pathsep)
        yield


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    """(model, kind) to an FMU and the folder that it was unpacked to; each is made once."""
    import fmpy
    from fmu_runner import ALL

    from dehyst.exports import export

    folder, known = tmp_path_factory.mktemp("fmu"), {}

    def get(model, kind):
        key = model, kind
        if key not in known:
            path = folder / f"{model}-{kind}.fmu"
            loop = ALL[model]
            if kind == "compensator":
                export(loop, path)
            else:
                export(replace(loop.actuator, state=loop._axes[0].given), path, period=loop.period)
            known[key] = path, Path(fmpy.extract(path, folder / path.stem))
        return known[key]

    return get


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened
