# pyright: strict
"""The virtual rig: starting it."""

from __future__ import annotations

from typing import Annotated, Literal

from cyclopts import App, Parameter

from cli.numbers import TimeScale
from cli.options import Settings
from rig_configs import load_rig

app = App(name="virtual", help="Start a virtual rig, and print its ports as one JSON line; Ctrl-C ends it.")


@app.default
def start(
    rig: str = "virtual",
    *,
    time_scale: TimeScale = 1.0,
    link: Literal["auto", "pty", "tcp"] = "auto",
    settings: Settings = None,
    while_stdin_open: Annotated[bool, Parameter(negative="", show=False)] = False,
) -> None:
    """Start a virtual rig and print its ports as one JSON line; Ctrl-C ends it."""
    from daq.virtual_rig.run import serve  # noqa: PLC0415 (only this command simulates)

    serve(load_rig(rig, settings=settings or []), time_scale, link, while_stdin_open)
