"""The formats to which an estimate is exported, one gate for all, and their results.

An entry names the function that exports, which is imported when it is called.
`exported` refuses estimates that must not be used, and floating bases that a format
cannot express; `exporter` gives functions that are called directly the same gate. An
`Export` is a file's content with its provenance, and notes on parts that the format
cannot express.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from importlib import import_module
from math import inf, nan, pi
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar

from consistent_id._support.files import write_atomically
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError

if TYPE_CHECKING:  # `consistent-id --help` lists the formats
    from consistent_id.estimation.estimate import Estimate
    from consistent_id.recordings.recording import Recording
    from consistent_id.recordings.signals import PDGains
    from consistent_id.robot.loaders.urdf_in_place import Edit, XmlText
    from consistent_id.robot.model import Joint

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class ExportFormat:
    """A format to which an estimate is exported.

    Parameters
    ----------
    content : str
        Description of the content, for people.
    module, function : str
        ``function(estimate, [source,] *, allow_refused) -> Export`` in a module of this
        package.
    floating : bool
        Whether the format can express a robot whose base floats.
    takes_source : bool
        Whether the estimate can be put into an existing file of the robot.
    has_assets : bool
        Whether that file refers to others, so that it matters where it is written.
    takes_gains : bool
        Whether gains and delay of PD-controlled joints are part of it.
    has_drives : bool
        Whether gains and a delay become a further file beside it.
    holds : tuple of str, optional
        Parameters of simulators (``damping``, ``friction``, ``armature``,
        ``stiffness``) and further drive terms that it has, or that the file has which
        it goes with; None if it has every term.
    lean : bool
        Whether it, or the file which it goes with, is `without_doubtful` terms.
    """

    name: str
    content: str
    module: str
    function: str
    floating: bool = False
    takes_source: bool = False
    has_assets: bool = False
    takes_gains: bool = False
    has_drives: bool = False
    holds: tuple[str, ...] | None = None
    lean: bool = False


_PLAIN = ("damping", "friction", "armature")
_MJCF = (*_PLAIN, "stiffness", "offset", "friction_slope", "drag")
_GEARS = ("coupling_viscous", "coupling_coulomb", "coupling_rotor_inertia")

EXPORT_FORMATS = (
    ExportFormat(
        "urdf",
        "URDF",
        "urdf_export",
        "to_urdf",
        floating=True,
        takes_source=True,
        holds=("damping", "friction"),
    ),
    ExportFormat(
        "mjcf",
        "MJCF",
        "mjcf_export",
        "to_mjcf",
        floating=True,
        takes_source=True,
        has_assets=True,
        has_drives=True,
        holds=(*_MJCF, *_GEARS),
        lean=True,
    ),
    ExportFormat("json", "JSON", "json_record", "to_json", floating=True),
    ExportFormat(
        "pin",
        "pinocchio.Model",
        "pinocchio_model",
        "pinocchio_file",
        floating=True,
        holds=_PLAIN,
    ),
    ExportFormat("numpy", "stand-alone NumPy", "numpy_source", "to_numpy"),
    ExportFormat("casadi", "CasADi function", "casadi_functions", "casadi_file"),
    ExportFormat("c", "C", "casadi_functions", "to_c"),
    ExportFormat(
        "isaaclab",
        "Isaac Lab actuators",
        "actuator_config",
        "to_isaac_lab",
        floating=True,
        takes_gains=True,
        holds=_PLAIN,
    ),
    ExportFormat(
        "mjlab",
        "mjlab actuators",
        "actuator_config",
        "to_mjlab",
        floating=True,
        takes_gains=True,
        holds=(*_MJCF, *_GEARS),
        lean=True,
    ),
)

_NAMED = 4  # of links in a note
_DOUBTFUL = ("offset", "spring")  # terms that are left out within their error
_UNFELT = 0.2  # of a joint's residual: torque of what is left out, at most
_ROUNDING = 1e-6  # of it: no term, but a solver's rounding

_COMMENT = re.compile(rb"\s*<!-- consistent-id: [^>]* -->")


class SideFile(NamedTuple):
    """Parts that a format cannot express, in a file with another suffix."""

    suffix: str
    content: bytes


@brief
@dataclass(frozen=True, slots=True)
class Export:
    """The content of a file, before it is written.

    Parameters
    ----------
    format : str
    content : bytes
    notes : tuple of str
        Parts of the estimate that the format cannot express, and changes made for the
        others.
    files : tuple of (Path, Path)
        Files to be copied, and where to, beside the content.
    side : SideFile, optional
    """

    format: str
    content: bytes
    notes: tuple[str, ...] = ()
    files: tuple[tuple[Path, Path], ...] = ()
    side: SideFile | None = None

    def __str__(self) -> str:
        return self.content.decode("utf-8", "replace")

    def paths(self, path: str | Path) -> tuple[Path, ...]:
        """Return the files that `save` writes: this one, then those beside it."""
        beside = [Path(path).parent / name for _, name in self.files]
        if self.side is not None:
            beside.insert(0, Path(path).with_suffix(self.side.suffix))
        return Path(path), *dict.fromkeys(beside)

    def save(self, path: str | Path) -> Path:
        """Write the content and the files beside it, each completely or not at all.

        Raises
        ------
        ProblemError
            If a folder cannot be written to, if another file would be overwritten, or
            if the path is that of the file beside it.
        """
        self._require_own_name(Path(path))
        beside = [(Path(path).parent / name, place) for place, name in self.files]
        for target, place in beside:
            if target.exists() and target.read_bytes() != place.read_bytes():
                raise ProblemError(
                    f"{target}: another file is there already, and {place} should be "
                    "copied to it; choose another folder"
                )
        for target, place in beside:
            if not target.exists():
                write_atomically(target, place.read_bytes())
        if self.side is not None:
            write_atomically(
                Path(path).with_suffix(self.side.suffix), self.side.content
            )
        return write_atomically(path, self.content)

    def _require_own_name(self, path: Path) -> None:
        if self.side is None or path.with_suffix(self.side.suffix) != path:
            return
        raise ProblemError(
            f"{path}: this is the name of the file that goes with {self.format}; "
            "choose another ending for the file itself"
            + (f", such as {path.with_suffix('.c').name}" if self.format == "c" else "")
        )


def exported(
    estimate: "Estimate",
    form: str,
    *,
    source: Path | None = None,
    folder: Path | None = None,
    copy_files: bool = False,
    gains: "PDGains | None" = None,
    delay: float = 0.0,
    commands: tuple[str, ...] = (),
    logs: "Sequence[Recording]" = (),
    allow_refused: bool = False,
) -> "Export":
    """Return an estimate in a format.

    Parameters
    ----------
    form : str
        Name of an entry of `EXPORT_FORMATS`.
    source : Path, optional
        File of the robot to put the estimate into; without it the file is new.
    folder : Path, optional
        Where it will be written, if files that it refers to are to be found from there.
    copy_files : bool
        Whether these files are to be copied there.
    gains : PDGains, optional
        Gains of PD-controlled joints.
    delay : float, [s]
        Delay of their commands.
    commands : tuple of str
        ``velocity`` and ``torque``, if the joints take such commands beside those of
        position.
    logs : sequence of Recording
        Motions that drives have to be able to make; see `to_mjcf`.

    Raises
    ------
    ProblemError
        If there is no such format, if it takes no source, if it cannot express a
        floating base, or if the estimate is refused and `allow_refused` is false.
    """
    known, options = known_format(form), dict[str, Any]()
    require_exportable(estimate, known.name, allow_refused=allow_refused)
    if source is not None:
        if not known.takes_source:
            taking = [f.content for f in EXPORT_FORMATS if f.takes_source]
            raise ProblemError(
                f"a source is for {' and '.join(taking)}, not for {form}"
            )
        options["source"] = source
        if known.has_assets:
            options |= {"folder": folder, "copy_files": copy_files}
    if known.has_drives:
        options |= {"commands": commands, "logs": logs}
    if known.takes_gains or known.has_drives:
        options |= {"gains": gains, "delay": delay}
    module = import_module(f"consistent_id.export.{known.module}")
    function = getattr(module, known.function)
    # The gate is passed: the function need not check the estimate again.
    export: Export = function(estimate, allow_refused=True, **options)
    notes = _of_springs(estimate, gains)
    if source is None:
        notes = (*_of_moving_joints(estimate), *notes)
    if known.holds is None or "drag" in known.holds:
        notes = (*notes, *_of_drag(estimate))
    return replace(export, notes=(*export.notes, *notes)) if notes else export


def _of_drag(estimate: "Estimate") -> tuple[str, ...]:
    """Return notes on joints whose friction would drive them beyond some speed."""
    from consistent_id.export.file_values import joint_drives

    beyond = []
    for drive in joint_drives(estimate):
        drag = drive.values.get("drag", 0.0)
        if drag < 0.0:
            speed = -drive.values.get("viscous", 0.0) / drag
            beyond.append(f"{drive.joint} {speed:.3g}")
    if not beyond:
        return ()
    return (
        "drag is negative: beyond these speeds [rad/s or m/s], viscous friction and "
        "drag drive the joint instead of braking it; stay below: " + ", ".join(beyond),
    )


def without_doubtful(estimate: "Estimate") -> tuple["Estimate", tuple[str, ...]]:
    """Return an estimate without offsets and springs that may be zero, and notes.

    They are those within their standard error whose torque is hardly felt: a file is
    simpler without them, and fits the data as well.  A term may be within its error
    and large, if other parameters make up for it.  It stays, because these do not
    change.  What is a solver's rounding is left out without a note: a spring that
    carries an offset would be stretched by it beyond all measure.
    """
    errors, layout = estimate.parameter_errors, estimate.model.layout
    x, left_out, rounded = estimate.parameters.copy(), [], False
    robot, sigma = estimate.model.robot, estimate.sigma
    sigma_of = dict(zip(estimate.model.torque_joints, sigma, strict=True))
    unfelt = {joint: _UNFELT * size for joint, size in sigma_of.items()}
    reach = {joint.name: _reach(joint) for joint in robot.driven}
    for name in _DOUBTFUL:
        for i in layout.drive_indices(name):
            joint = layout.drive[i - layout.inertial_size][0]
            torque = abs(x[i]) * (reach[joint] if name == "spring" else 1.0)
            if 0.0 < torque <= _ROUNDING * sigma_of.get(joint, 0.0):
                x[i], rounded = 0.0, True
                continue
            error = nan if errors is None else float(errors[i])
            within = x[i] != 0.0 and abs(x[i]) <= error
            if within and torque <= unfelt.get(joint, 0.0):
                left_out.append(f"{layout.names[i]} {x[i]:.2g} +- {error:.2g}")
                unfelt[joint] -= torque
                x[i] = 0.0
    if not left_out:
        return (replace(estimate, parameters=x) if rounded else estimate), ()
    note = (
        "left out, as within their standard error and hardly felt in the torque: "
        + ", ".join(left_out)
    )
    return replace(estimate, parameters=x), (note,)


def _reach(joint: "Joint") -> float:
    """Return a joint's largest position [rad or m]; half a turn without limits."""
    largest = max(abs(joint.limits.lower), abs(joint.limits.upper))
    return largest if largest < inf else pi


def exporter(form: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Give a function that exports to a format the gate of `exported`.

    Parameters
    ----------
    form : str
        Name of an entry of `EXPORT_FORMATS`.

    Returns
    -------
    callable
        From ``function(estimate, ..., allow_refused=False)`` to the same function that
        refuses what `exported` refuses.
    """

    def gated(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def checked(*args: P.args, **options: P.kwargs) -> R:
            estimate: Any = args[0] if args else options["estimate"]
            refused = bool(options.get("allow_refused", False))
            require_exportable(estimate, form, allow_refused=refused)
            return function(*args, **options)

        return checked

    return gated


def known_format(form: str) -> ExportFormat:
    """Return a format by its name.

    Raises
    ------
    ProblemError
        With the names that are known.
    """
    formats = {known.name: known for known in EXPORT_FORMATS}
    if form not in formats:
        from consistent_id.robot.parameters import did_you_mean

        raise ProblemError(f"no format {form!r}; {did_you_mean(form, formats)}")
    return formats[form]


def require_exportable(
    estimate: "Estimate", form: str, *, allow_refused: bool = False
) -> None:
    """Refuse bases that a format cannot express, and estimates not to be used.

    Raises
    ------
    ProblemError
        With the reason of the verdict, or the formats that have such a base.
    """
    from consistent_id.estimation.estimate import Estimate

    require_type(estimate, Estimate, "estimate")
    known, robot = known_format(form), estimate.model.robot
    if robot.floating and not known.floating:
        others = ", ".join(f.name for f in EXPORT_FORMATS if f.floating)
        raise ProblemError(
            f"{known.content}: the format has dynamics of joints only, but the base "
            f"of {robot.name!r} floats; formats for it are {others}"
        )
    if allow_refused or (verdict := estimate.verdict).usable:
        return
    from consistent_id.estimation.verdict import HELP

    ground = verdict.grounds[0]
    raise ProblemError(
        f"{verdict.sentence}: {ground.statement}. {ground.advice}; or use "
        f"allow_refused (--accept {ground.kind!r} in the shell). See {HELP}"
    )


def _of_moving_joints(estimate: "Estimate") -> tuple[str, ...]:
    """Return the note on joints of the robot's file that a new file does not have."""
    robot = estimate.model.robot
    fixed = [frame.name for link in robot.links for frame in link.merged]
    if not fixed and not robot.ground:
        return ()
    count = sum(joint.kind != "free" for joint in robot.joints)
    joints = "1 joint that moves" if count == 1 else f"{count} joints that move"
    inside = f": {', '.join(fixed[:_NAMED])}" if fixed else ""
    more = f" and {len(fixed) - _NAMED} more" if len(fixed) > _NAMED else ""
    merged = (
        f"; links on fixed or locked joints are parts of the links that carry "
        f"them{inside}{more}"
        if fixed
        else ""
    )
    return (f"the file has only the {joints}{merged}",)


def _of_springs(estimate: "Estimate", gains: "PDGains | None") -> tuple[str, ...]:
    """Return the note on springs between motors and links, which no file has."""
    from math import isfinite

    if gains is None:
        return ()
    joints = estimate.model.robot.joint_names
    springs = ", ".join(
        f"{joint} ({k:.3g} N m/rad)"
        for joint, k in zip(joints, gains.of(len(joints)).stiffness, strict=True)
        if isfinite(k)
    )
    if not springs:
        return ()
    return (
        f"the file has no springs between motors and links, of {springs}: in MuJoCo, "
        "give the body a second joint on the same axis, with that stiffness",
    )


def provenance(estimate: "Estimate") -> str:
    """Return one line for a file's comment: method, robot, verdict."""
    verdict = estimate.verdict
    accepted = f", accepted: {', '.join(verdict.accepted)}" if verdict.accepted else ""
    return (
        f"consistent-id: robot {estimate.model.robot.name}, method {estimate.method}, "
        f"verdict: {verdict}{accepted}"
    )


def comment_text(text: str) -> str:
    """Return text for a comment of XML, in which two hyphens may not follow each other.

    Examples
    --------
    >>> comment_text("arm---left -> right")
    'arm- - -left - right'
    """
    return re.sub("-(?=-)", "- ", text).replace(">", "")


def comment_edit(document: "XmlText", text: str) -> "Edit":
    """Return the edit that puts a comment first, in place of an earlier one."""
    line = comment_text(text)
    edit = document.insert(document.root, [[f"<!-- {line} -->"]])
    earlier = _COMMENT.match(document.data, edit.start)
    return edit if earlier is None else edit._replace(stop=earlier.end())
