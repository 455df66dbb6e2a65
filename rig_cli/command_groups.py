"""The commands of `rig` in the order of the work: where each is implemented, and its sentence in the overview.

`rig --help` and the page docs/commands.md are made from this table. It imports no command.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        place: "module:attribute" of its function, or of its cyclopts application with commands of its own.
        sentence: what it does; the first line of its own help.
        more: the other lines of the own help of an application. A function has them in its docstring. cyclopts writes a
            given help into the application, which all command lines of the process share.
    """

    place: str
    sentence: str
    more: str = ""

    @property
    def own_help(self) -> str | None:
        """Help of an application; None for a function."""
        return f"{self.sentence}\n\n{self.more}" if self.more else None


GROUPS: dict[str, dict[str, Command]] = {
    "Set up": {
        "devices": Command(
            "rig_cli.devices:devices",
            "List the ports and the devices on them, with tables to paste into a rig file.",
        ),
        "check": Command(
            "rig_cli.acquire:check", "Compare the devices of a rig with its rig file: identities, rates, faults."
        ),
        "calibrate": Command(
            "rig_cli.calibrate:calibrate",
            "Calibrate a laser against gauge blocks or a micrometer, or the encoders at their locks.",
        ),
        "virtual": Command(
            "rig_cli.virtual:app",
            "Start a virtual rig, and operate it from another terminal.",
            "Its ports are printed as one JSON line. Ctrl-C or `rig virtual stop` ends it.\n\nExample: `rig virtual`",
        ),
        "completion": Command(
            "rig_cli.completion:completion",
            "Print the script with which a shell completes commands and options of rig.",
        ),
    },
    "Run": {
        "demo": Command(
            "rig_cli.demo:demo", "Record, identify, validate and report a whole campaign on the virtual rig."
        ),
        "plan": Command(
            "rig_cli.plan:plan",
            "List the experiments that reach a wanted uncertainty: duration, amplitude, sample rate.",
        ),
        "test": Command(
            "rig_cli.guided_test:test",
            "Run one guided test, show its plan, or list the tests that a rig still needs.",
        ),
        "record": Command(
            "rig_cli.acquire:record", "Record every device of a rig, and show rates, losses and the disk."
        ),
        "live": Command("rig_cli.live:live", "Show a rig or a log in the browser, with a stop button."),
    },
    "Identify": {
        "identify": Command(
            "rig_cli.offline:identify", "Identify k1, k2, ζ1, ζ2, c3, c4, S_P with covariance from logs."
        ),
        "parameters": Command(
            "rig_cli.parameters:app",
            "Show identified parameters, compare them, follow them over time.",
            "Example: `rig parameters diff before.toml after.toml`",
        ),
        "track": Command("rig_cli.track:track", "Follow states and pendulum damping through a log, with uncertainty."),
    },
    "Understand": {
        "validate": Command("rig_cli.offline:validate", "Compare steady states and releases at points with the model."),
        "report": Command("rig_cli.report:report", "Write the report of a campaign from its logs."),
        "plot": Command("rig_cli.plot:plot", "Draw logs as orbit, Bode, polar, waterfall and more, with the model."),
        "predict": Command(
            "rig_cli.model:predict", "Predict steady states, stability and amplitudes, and where a release ends."
        ),
        "map": Command(
            "rig_cli.maps:map", "Map where the balanced state is stable, over any two numbers of the rig file."
        ),
        "basins": Command(
            "rig_cli.basins:basins",
            "Map where releases end, over the angles at which the locks hold the pendulums.",
        ),
        "react": Command("rig_cli.react:react", "Simulate how the pendulums answer a sudden change at speed."),
    },
    "Data": {
        "logs": Command("rig_cli.logs:logs", "List the logs of a folder and of the folders below it, newest first."),
        "log": Command("rig_cli.logs:log", "Show what is in one log, and check every byte of it."),
        "export": Command(
            "rig_cli.exchange:export",
            "Write a log's channels for other programs: parquet, csv, MATLAB/Octave, hdf5.",
        ),
        "import": Command(
            "rig_cli.exchange:import_", "Make a log of a csv, parquet, mat or hdf5 file recorded elsewhere."
        ),
        "replay": Command("rig_cli.replay:replay", "Decode a log's raw bytes again through the same pipelines."),
        "recover": Command("rig_cli.recover:recover", "Make a cut or damaged log whole, and list what is missing."),
    },
    "Develop": {
        "driver": Command(
            "rig_cli.drivers:app",
            "List the drivers, show the settings of one, check it against what every driver must do.",
            "Example: `rig driver show optoncdt`",
        ),
        "bench": Command(
            "rig_cli.bench:bench", "Measure time against true error for every method, with peers in the same run."
        ),
        "study": Command(
            "rig_cli.studies:app",
            "Run campaigns by the hundred, or identify an archive again, on one machine or many.",
            "Example: `rig study campaigns`",
        ),
        "reproduce": Command(
            "rig_cli.reproduce:reproduce", "Reproduce figures and tables of the source and judge its claims."
        ),
    },
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
