"""The formats to which an estimate is exported: one entry each.

An entry names the function that exports, which is imported when it is called.
"""

from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from consistent_id.errors import ProblemError

if TYPE_CHECKING:
    from consistent_id.estimation.estimate import Estimate
    from consistent_id.export.exported_file import Export
    from consistent_id.recordings.signals import PDGains


@dataclass(frozen=True, slots=True)
class ExportFormat:
    """A format to which an estimate is exported.

    Parameters
    ----------
    content : str
        What is written, for people.
    module, function : str
        ``function(estimate, [source,] *, allow_refused) -> Export`` in a module of this
        package.
    takes_source : bool
        Whether the estimate can be put into an existing file of the robot.
    has_assets : bool
        Whether that file refers to others, so that it matters where it is written.
    takes_gains : bool
        Whether gains and delay of PD-controlled joints are part of it.
    """

    name: str
    content: str
    module: str
    function: str
    takes_source: bool = False
    has_assets: bool = False
    takes_gains: bool = False


EXPORT_FORMATS = (
    ExportFormat("urdf", "URDF", "urdf_export", "to_urdf", takes_source=True),
    ExportFormat(
        "mjcf", "MJCF", "mjcf_export", "to_mjcf", takes_source=True, has_assets=True
    ),
    ExportFormat("json", "JSON", "json_record", "to_json"),
    ExportFormat("pin", "pinocchio.Model", "pinocchio_model", "pinocchio_file"),
    ExportFormat("numpy", "stand-alone NumPy", "numpy_source", "to_numpy"),
    ExportFormat("casadi", "CasADi function", "casadi_functions", "casadi_file"),
    ExportFormat("c", "C", "c_source", "to_c"),
    ExportFormat(
        "isaaclab",
        "Isaac Lab actuators",
        "actuator_config",
        "to_isaac_lab",
        takes_gains=True,
    ),
    ExportFormat(
        "mjlab", "mjlab actuators", "actuator_config", "to_mjlab", takes_gains=True
    ),
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
        Of PD-controlled joints.
    delay : float, [s]
        Of their commands.

    Raises
    ------
    ProblemError
        If there is no such format, if it takes no source, or if the estimate is refused
        and `allow_refused` is false.
    """
    formats = {known.name: known for known in EXPORT_FORMATS}
    if form not in formats:
        from consistent_id.robot.parameters import did_you_mean

        raise ProblemError(f"no format {form!r}; {did_you_mean(form, formats)}")
    known, options = formats[form], dict[str, Any]()
    if source is not None:
        if not known.takes_source:
            taking = [f.content for f in EXPORT_FORMATS if f.takes_source]
            raise ProblemError(
                f"a source is for {' and '.join(taking)}, not for {form}"
            )
        options["source"] = source
        if known.has_assets:
            options |= {"folder": folder, "copy_files": copy_files}
    if known.takes_gains:
        options |= {"gains": gains, "delay": delay}
    module = import_module(f"consistent_id.export.{known.module}")
    function = getattr(module, known.function)
    export: Export = function(estimate, allow_refused=allow_refused, **options)
    notes = _of_springs(estimate, gains)
    return replace(export, notes=(*export.notes, *notes)) if notes else export


def _of_springs(estimate: "Estimate", gains: "PDGains | None") -> tuple[str, ...]:
    """Say that no file has the springs between motors and links."""
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
