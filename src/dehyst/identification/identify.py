"""Records of voltage and displacement to an identified actuator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

from numpy.typing import ArrayLike

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._threads import one_thread
from dehyst._types import Progress
from dehyst.identification.deadline import Deadline
from dehyst.identification.plain_class import identify_at_breakpoints, identify_plain
from dehyst.identification.preprocessing.block_means import ENOUGH
from dehyst.identification.preprocessing.preparation import Prepared, as_list, prepare
from dehyst.identification.run import Run
from dehyst.identification.settings import Direction, Method, Settings
from dehyst.identification.solvers.program import Norm
from dehyst.identification.wider_class import identify_structure
from dehyst.model import Actuator, Fit, Outcome, Structure
from dehyst.records import Record


def identify(
    records: Record | Sequence[Record],
    *,
    validate: Record | Sequence[Record] = (),
    method: Method = "record",
    elements: int | None = None,
    breakaway: ArrayLike | None = None,
    norm: Norm = "l1",
    knots: int | None = None,
    slope_floor: float = 0.2,
    delay: float | None = None,
    sensor_lag: float | None = None,
    shared_datum: bool = False,
    drift: bool = True,
    branch: Direction = "descending",
    structure: Structure | Literal["auto", "paper"] = "auto",
    refine: bool = False,
    goal: float = 1.0,
    throw: bool = True,
    progress: Progress | None = None,
    time_limit: float | Deadline | None = None,
    first_model: Callable[[Actuator], None] | None = None,
) -> Fit:
    """Identify an actuator from records of major and minor loops; none needs to start relaxed.

    Parameters
    ----------
    records : Record or sequence of Record
        Training records, together with one loop at least; minor loops decide how well other motions are predicted.
    validate : Record or sequence of Record, optional
        Records that are only simulated. Each gets its own constant (and datum and drift), as training records do.
    method : {"record", "breakpoints", "antisymmetric"}
        Every sample of every record (default); the paper's linear program on break points (Sec. 4.1); Remark 2's
        closed form, without a nonlinear spring.
    elements : int, optional
        Number N of slip elements on the paper's uniform grid over the widest loop, rho_i = i range / (2 N);
        default 20 (10 for the paper's methods).
    breakaway : (N,) array_like, optional
        Breakaway elongations [m] in place of the grid; "record" only.
    norm : {"l1", "l2", "linf"}, optional
        Of the weighted residuals; "record" only.
    knots : int, optional
        Knots of the spring; default N + 1, 41 at most. "record" only.
    slope_floor : float, optional
        Least slope of the spring as a fraction of the mean slope of the widest loop (Assumption I with a margin).
    delay : float, optional
        Seconds by which the displacement lags the voltage; default: estimated from the training records.
    sensor_lag : float, optional
        Time constant of the sensor's own filter [s], a low-pass of first order, 0 if it has none; default: unknown.
        Any other lag counts as the actuator's: a record does not show which of them lags.
    shared_datum : bool, optional
        Say that no record zeroed its sensor anew; default: each record's datum is looked for.
    drift : bool, optional
        Whether a record may creep by a logarithm of the time since its start, which is then set aside.
    branch : {"descending", "ascending"}, optional
        "antisymmetric" only.
    structure : {"auto", "paper"} or Structure, optional
        How much model: what cycles held out in turn ask for (default: more elements, a transformer, graded elements,
        creep, smooth elements, inertia), the paper's class, or a class that is given. What only the paper's class knows
        (elements, breakaway, knots, another method) asks for that class.
    refine : bool, optional
        Try Gauss-Newton steps that make the error of simulation small, thresholds free, and keep them if they are
        better on cycles held out; not for the paper's class ("paper").
    goal : float, optional
        Largest error [% of the stroke] with which the model is ready for use: see `Expectation`.
    throw : bool, optional
        Raise if the solver finds no optimum (default), or return a Fit with `Outcome.FAILED`.
    progress : callable, optional
        Called with a few words at each step.
    time_limit : float or Deadline, optional
        Seconds after which no further step of a search begins; the best model so far is completed, by least squares if
        the program in another norm is not solved by then, and `Fit.remarks` names it. That takes some time more.
        Another thread or a signal handler can end a `Deadline`.
    first_model : callable, optional
        Called once with a plain actuator, as soon as delay and sensor data are known; "record" only. It is a
        least-squares fit of few samples and was not checked: its provenance has `"provisional": True`.

    Returns
    -------
    Fit

    Raises
    ------
    RecordError
        If a record cannot be used: no loop, columns swapped, a clipped sensor, too few samples or cycles.
    IdentifyError
        If an option is impossible, or no sample determines anything of the elements.
    """
    settings = Settings(
        method,
        elements,
        breakaway,  # type: ignore[arg-type]
        norm,
        knots,
        slope_floor,
        delay,
        sensor_lag,
        shared_datum,
        drift,
        branch,
    )
    _validation.between(goal, "goal", 1e-3, 100, "a part of the stroke in %")
    deadline = time_limit if isinstance(time_limit, Deadline) else Deadline(time_limit)
    report = deadline.watched(progress or (lambda _: None))
    training, held_out = as_list(records), as_list(validate)
    if not training:
        raise IdentifyError("got no records, need one loop of voltage and displacement at least")
    counted = elements is not None or knots is not None or settings.breakaway is not None
    if structure == "auto" and (counted or method != "record"):
        structure = "paper"
    _refuse_structure(structure, settings, counted)
    _refuse_copies([*training, *held_out])
    if refine and structure == "paper":
        raise IdentifyError("refine: the paper's class is fitted as it is; leave refine out, or try structure='auto'")
    report("checking the records")
    # The paper's class takes every sample as it is.
    most = 1.0 if structure == "paper" else sum(map(len, training)) / ENOUGH
    with one_thread():
        run = Run(
            settings,
            [_prepared(record, most, settings.sensor_lag) for record in training],
            [_prepared(record, most, settings.sensor_lag) for record in held_out],
            report,
            goal,
            deadline,
            first_model,
        )
        if structure != "paper":
            fit = identify_structure(run, structure, refine)
        else:
            fit = identify_plain(run) if method == "record" else identify_at_breakpoints(run)
    if fit.outcome is Outcome.FAILED and throw:
        raise IdentifyError(f"{fit.outcome.value} {fit.status}. Try another norm or fewer elements")
    return fit


def _prepared(record: Record, most: float, sensor_lag: float | None) -> Prepared:
    """Prepare a record, to be reduced to means of `most` samples at most; before the lag of its sensor, if given."""
    found = prepare(record).with_block(most)
    return found.reduced.without_lag(sensor_lag) if sensor_lag else found


def _refuse_copies(records: list[Record]) -> None:
    """Refuse a record given twice: cycles held out would not be unseen, nor would be a record that is."""
    seen: dict[bytes, str] = {}
    for one in records:
        key = one.displacement.tobytes() + one.voltage.tobytes()
        if key in seen:
            raise IdentifyError(
                f"{one.name}: has the same samples as {seen[key]}; give each record once, and another one to validate"
            )
        seen[key] = one.name


def _refuse_structure(structure: object, settings: Settings, counted: bool) -> None:
    """Refuse what is no structure, and options that have no meaning beside one."""
    if structure == "paper":
        return
    if structure != "auto" and not isinstance(structure, Structure):
        raise IdentifyError(f"structure: got {structure!r}, need 'auto', 'paper' or a dehyst.model.structure.Structure")
    if settings.method != "record":
        raise IdentifyError(f"structure: method {settings.method!r} knows the paper's class only; leave one out")
    if counted:
        raise IdentifyError("structure: it has elements and knots of its own; leave elements, breakaway and knots out")
