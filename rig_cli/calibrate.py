"""`rig calibrate`: one sensor against known positions, or the encoders against their locks."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from analysis.figures.gauge import gauge_residuals
from analysis.figures.style import save
from daq.acquisition.session import Session
from daq.calibration.encoder import MIN_CLOSINGS, check_senses, close_repeatedly, judge
from daq.calibration.lengths import BadLength, KnownPosition, positions_of
from daq.calibration.line import TooFewPositions
from daq.calibration.sensor import SensorSetup, calibrate as calibrate_sensor, read_positions, there_and_back
from daq.guided_tests.commands import RigCommands
from daq.guided_tests.controls import Controls
from daq.lockstep.rig import LockstepRig
from daq.log.file import ReservedName
from daq.log.numbering import next_number, one_at_a_time
from daq.transports import HostClock
from daq.version import software_version
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_cli.calibrate_page import encoder_facts, sensor_facts, show_encoder, show_sensor
from rig_cli.calibrated_rig_file import name_of_record, old_values, write_record, write_settings
from rig_cli.console import notify, print_json
from rig_cli.keyboard import Keyboard, Keys, TerminalOperator
from rig_cli.numbers import Positive, PositiveSeconds
from rig_cli.option_groups import CLOSINGS, POSITIONS
from rig_cli.options import Json, RigFile, Settings, check_outputs, warn_of_unusual_settings
from rig_configs import RigFileError
from rig_configs.device import DisplacementSettings
from rig_configs.load import rig_from_text, rig_text, validate
from rig_configs.schema import Rig


@Parameter(name="*", group=POSITIONS)
@dataclass(frozen=True)
class Positions:
    """Known positions of a sensor's target.

    Attributes:
        block: positions in their order.
        once: whether they are not repeated in the reverse order.
        toward: whether a larger position brings the target nearer to the sensor.
        at_disk: whether they are displacements of the disk.
        zero_at: position that is displacement 0.
        seconds: duration of a reading, s.
    """

    block: Annotated[
        list[str] | None,
        Parameter(
            help="'2.000 mm ± 1 µm' (standard uncertainty), or several: '2, 4, 6 mm ± 1 um'; repeat the option",
            allow_leading_hyphen=True,
        ),
    ] = None
    once: Annotated[bool, Parameter(negative="", help="do not repeat the positions in the reverse order")] = False
    toward: Annotated[bool, Parameter(negative="", help="a larger position is nearer to the sensor")] = False
    at_disk: Annotated[bool, Parameter(negative="", help="positions of the disk: gain and lever together")] = False
    zero_at: Annotated[
        str | None, Parameter(help="'6 mm ± 1 µm': the position that is displacement 0", allow_leading_hyphen=True)
    ] = None
    seconds: Annotated[PositiveSeconds, Parameter(help="of one reading")] = 2.0

    def known(self) -> list[KnownPosition]:
        """Return the positions in the order of the readings."""
        given = [one for text in self.block or [] for one in _length(text)]
        return given if self.once else there_and_back(given)

    def setup(self) -> SensorSetup:
        """Return how the positions relate to the readings."""
        zero = _length(self.zero_at)[0].position_m if self.zero_at else None
        return SensorSetup(self.toward, self.at_disk, self.seconds, zero)


@Parameter(name="*", group=CLOSINGS)
@dataclass(frozen=True)
class Closings:
    """How the encoders are calibrated.

    Attributes:
        closings: how often the locks are closed.
        lock_std_deg: standard uncertainty of the places of the locks.
    """

    closings: Annotated[int, Parameter(help="how often the locks are closed")] = 5
    lock_std_deg: Annotated[Positive, Parameter(help="standard uncertainty of the places of the locks")] = 0.05


@Parameter(name="*")
@dataclass(frozen=True)
class Calibrating:
    """Where a calibration is done and written.

    Attributes:
        out: folder of the log.
        write: whether the result is written without a question.
        rehearse: whether the virtual rig and a simulated operator are used.
    """

    out: Annotated[Path, Parameter(help="folder of the log and the figure")] = Path("out")
    write: Annotated[bool, Parameter(negative="", help="write the result into the rig file without a question")] = False
    rehearse: Annotated[
        bool, Parameter(negative="", help="on the virtual rig, in this process, with a simulated operator")
    ] = False


_POSITIONS, _CLOSINGS, _CALIBRATING = Positions(), Closings(), Calibrating()


@dataclass(frozen=True)
class _Outcome:
    """Result of a calibration.

    Attributes:
        values: settings for the rig file.
        facts: numbers for the record.
        refusals, warnings: texts.
    """

    values: Mapping[str, float]
    facts: Mapping[str, Any]
    refusals: tuple[str, ...]
    warnings: tuple[str, ...]


def calibrate(
    rig: RigFile,
    device: Annotated[str, Parameter(help="its name in the rig file")],
    *,
    positions: Positions = _POSITIONS,
    closings: Closings = _CLOSINGS,
    options: Calibrating = _CALIBRATING,
    settings: Settings = None,
    json: Json = False,
) -> int:
    """Calibrate a laser against gauge blocks or a micrometer, or the encoders at their locks.

    The exit code is 1 if the calibration is refused.

    Example: `rig calibrate my.toml laser_x --block "-4, 0, 4 mm ± 1 µm"`
    """
    source, text = rig_text(rig)
    loaded = rig_from_text(source, text, settings=settings or [])
    kind = _kind(loaded, device)
    known, setup = positions.known(), positions.setup()
    _need_input(kind, known, closings)
    if options.write and not Path(rig).is_file():
        raise RigFileError(f"--write: {rig} is a shipped rig, which is not changed; copy it to a file of your own")
    if not options.rehearse:
        warn_of_unusual_settings(loaded)
    check_outputs("--out", options.out / "log" if options.out.exists() else options.out, force=True)
    options.out.mkdir(exist_ok=True)
    with _opened(loaded, device if kind == "sensor" else "", options) as (session, operator):
        log = _begin(session, options.out, device)
        if kind == "sensor":
            found = _sensor(session, loaded, device, known, setup, operator, log.with_suffix(".svg"))
        else:
            found = _encoder(session, closings, operator)
        session.stop_recording({"calibration": dict(found.values), "refused": list(found.refusals)})
        identity = dict(session.identities.get(device, {}))
    return _finish(rig, text, device, found, {"identity": identity, "log": log.name}, options, json)


def _length(text: str) -> list[KnownPosition]:
    try:
        return positions_of(text)
    except BadLength as error:
        raise RigFileError(str(error)) from error


def _kind(rig: Rig, device: str) -> str:
    if device not in rig.devices:
        raise RigFileError(f"no device {device!r}; this rig has {', '.join(rig.devices)}")
    if isinstance(rig.devices[device], DisplacementSettings):
        return "sensor"
    if rig.roles.angles is not None and rig.roles.angles.device == device:
        return "encoder"
    raise RigFileError(f"{device}: expected a displacement sensor or the device of the pendulum angles")


def _need_input(kind: str, known: list[KnownPosition], closings: Closings) -> None:
    """Check the numbers of the command line before a device is opened."""
    if kind == "sensor" and len({one.position_m for one in known}) < 2:
        raise RigFileError(
            "expected at least two positions, better five over the range: --block '-4, -2, 0, 2, 4 mm ± 1 µm'"
        )
    if kind == "encoder" and not MIN_CLOSINGS <= closings.closings <= 100:
        raise RigFileError(f"--closings {closings.closings}: expected {MIN_CLOSINGS} to 100")


@contextmanager
def _opened(rig: Rig, sensor: str, options: Calibrating) -> Generator[tuple[Session, Any]]:
    """Open a rig and yield the session with its operator.

    Args:
        rig: the rig file.
        sensor: the only device to open, without its present calibration; "": the whole rig.
    """
    if options.rehearse:
        far = LockstepRig(rig)
        with Session(_alone(_plugged(rig, far), sensor), far.clock, notify=notify, edge=far.edge) as session:
            yield session, SimulatedOperator(far)
        return
    session = Session(_alone(rig, sensor), HostClock(), notify=notify)
    with Keyboard(Keys(Controls())) as keyboard, session:
        yield session, TerminalOperator(keyboard)


def _plugged(rig: Rig, far: LockstepRig) -> Rig:
    raw = rig.model_dump(exclude_unset=True)
    for name, cable in far.cables.items():
        raw["devices"][name]["port"] = cable.port
    return validate(raw, rig.name)


def _alone(rig: Rig, sensor: str) -> Rig:
    """Return the rig with one sensor without its calibration; "": the whole rig."""
    if not sensor:
        return rig
    raw = rig.model_dump(exclude_unset=True)
    plain = {"gain_factor": 1.0, "offset_m": 0.0, "calibrated": "", "calibration_record": "", "witness": ""}
    raw["devices"] = {sensor: raw["devices"][sensor] | plain}
    raw.pop("instruments", None)
    return validate(raw, rig.name)


def _begin(session: Session, folder: Path, device: str) -> Path:
    with one_at_a_time(folder):
        number = next_number(p.name for p in folder.iterdir())
        name = ReservedName(folder / f"{number:02d}-calibrate-{device}.mcap")
        session.start_recording(name, {"test": "calibrate", "device": device})
    return name.path


def _sensor(
    session: Session,
    rig: Rig,
    device: str,
    known: list[KnownPosition],
    setup: SensorSetup,
    operator: Any,
    figure: Path,
) -> _Outcome:
    settings = rig.devices[device]
    assert isinstance(settings, DisplacementSettings), "the kind was checked"
    readings = read_positions(session, device, known, operator, setup, notify)
    gain_std = next(r.gain_std for r in (*rig.roles.displacements, *rig.roles.witnesses) if r.device == device)
    try:
        found = calibrate_sensor(readings, settings, gain_std, setup)
    except TooFewPositions as error:
        raise RigFileError(str(error)) from error
    save(figure, gauge_residuals(found.line, device))
    notify(f"{figure}: residuals drawn")
    return _Outcome(found.settings(setup.at_disk), sensor_facts(found, setup), found.refusals, found.warnings)


def _encoder(session: Session, closings: Closings, operator: Any) -> _Outcome:
    def progress(text: str, share: float | None) -> None:
        notify(text)

    locks = RigCommands(session, operator, Path(), progress).locks
    senses = check_senses(session, operator, locks, notify)
    closed = close_repeatedly(session, operator, locks, closings.closings, notify)
    found = judge(closed, senses, closings.lock_std_deg)
    return _Outcome(found.settings(), encoder_facts(found, closings.lock_std_deg), found.refusals, ())


def _finish(
    rig: str,
    text: str,
    device: str,
    found: _Outcome,
    origin: Mapping[str, Any],
    options: Calibrating,
    json: bool,
) -> int:
    """Show the result, and write it if it is not refused and the operator agrees."""
    show: Callable[[Mapping[str, Any]], None] = show_sensor if "gain" in found.facts else show_encoder
    if not json:
        show(found.facts)
    for line in found.warnings:
        notify(f"warning: {line}")
    for line in found.refusals:
        notify(f"refused: {line}")
    when, file = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), Path(rig)
    written = ""
    if not found.refusals and _agreed(file, options.write, json):
        before = old_values(file, device, {**found.values, "calibrated": "", "calibration_record": ""})
        facts = {"device": device, "calibrated": when, "software": software_version(), "rig_file": file.name, **origin}
        record = {**facts, "result": found.facts, "before": before, "after": dict(found.values)}
        path = write_record(file.resolve().parent, device, when, {**record, "warnings": list(found.warnings)})
        stamp = {"calibrated": when, "calibration_record": name_of_record(path)}
        try:
            write_settings(file, device, {**found.values, **stamp}, text)
        except BaseException:
            path.unlink(missing_ok=True)  # no rig file refers to it
            raise
        written = str(path)
        notify(f"{file}: devices.{device} has the new values; the old ones are in {path}")
    if json:
        print_json(
            {
                "device": device,
                "verdict": "refused" if found.refusals else "pass",
                "refusals": list(found.refusals),
                "warnings": list(found.warnings),
                "values": dict(found.values),
                "result": found.facts,
                "record": written or None,
                "log": origin["log"],
            }
        )
    return 1 if found.refusals else 0


def _agreed(file: Path, write: bool, json: bool) -> bool:
    """Return whether the result may be written into the rig file."""
    if not file.is_file():
        notify("not written: a shipped rig is not changed. Copy it to a file of your own and give that")
        return False
    if write:
        return True
    if json or not Keyboard(Keys(Controls())).there:
        notify("not written: give --write to write the result into the rig file")
        return False
    notify(f">>> write these values into {file}? y and Enter to write, Enter to leave the file as it is")
    return input().strip().lower() in ("y", "yes")
