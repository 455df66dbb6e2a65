"""Commands about logs: all of a folder, and one."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from cyclopts import Parameter

from daq.catalogue.query import Query, Sort, parse_instant
from rig_cli.console import notify, print_json
from rig_cli.log_table import print_logs
from rig_cli.option_groups import CONDITIONS
from rig_cli.options import Force, Json, check_outputs
from rig_cli.share_progress import share_progress
from rig_cli.words import local_time

if TYPE_CHECKING:
    from daq.log import Log

Flag = Annotated[bool, Parameter(negative="")]


@Parameter(name="*", group=CONDITIONS)
@dataclass(frozen=True)
class LogFilter:
    """Conditions on the listed logs. Empty ones admit every log.

    Attributes:
        rig: must be in the rig's name.
        test: must be in the test's name.
        point: the point's name.
        note: must be in the operator's note.
        parameters: must be in the name or digest of the parameters laid over the rig file.
        verdict: pass, fail, …, stale (the log is not the one that was judged), none.
        since: recorded since then: 2026-03-01, 2026-03-01T10:00, today, or how long ago: 3d, 12h, 30min, 2w.
        until: recorded until then; a day means its end.
        lost: only logs in which samples or frames were lost.
        complete: only whole files.
        incomplete: only cut, damaged and unreadable files.
    """

    rig: str = ""
    test: str = ""
    point: str = ""
    note: str = ""
    parameters: str = ""
    verdict: str = ""
    since: str | None = None
    until: str | None = None
    lost: Flag = False
    complete: Flag = False
    incomplete: Flag = False

    def query(self, words: tuple[str, ...], sort: Sort, reverse: bool) -> Query:
        """Return the catalogue's query.

        Raises:
            ValueError: the text has what was expected.
        """
        if self.complete and self.incomplete:
            raise ValueError("expected one of --complete and --incomplete, got both")
        try:
            since, until = (
                None if text is None else parse_instant(text, datetime.now(), end)
                for text, end in ((self.since, False), (self.until, True))
            )
        except ValueError as fault:
            raise ValueError(f"--since, --until: {fault}") from fault
        return Query(
            words,
            self.rig,
            self.test,
            self.point,
            self.note,
            self.parameters,
            self.verdict,
            since,
            until,
            lost=True if self.lost else None,
            complete=self.complete if self.complete or self.incomplete else None,
            sort=sort,
            reverse=reverse,
        )


_EVERY_LOG = LogFilter()


def logs(
    folder: Path,
    *words: str,
    only: LogFilter = _EVERY_LOG,
    sort: Sort = "started",
    reverse: Flag = False,
    json: Json = False,
) -> int:
    """List the logs of a folder and of the folders below it, newest first.

    Example: `rig logs out spin-down`

    Args:
        folder: where the logs are.
        words: each must be in the rig's name, test, point, note or file name.
        sort: by what; times, sizes and counts largest first.
        reverse: the other way round.
    """
    from daq.catalogue import Catalogue  # the log's reader takes half a second to import

    try:
        query = only.query(words, sort, reverse)
    except ValueError as fault:
        notify(f"rig logs: {fault}")
        return 2
    catalogue = Catalogue(folder)
    with ExitStack() as stack:
        entries = catalogue.entries(_progress_when_called(stack, "reading new logs"))
    found = query.sorted(entry for entry in entries if query.admits(entry))
    if catalogue.cache_trouble:
        notify(f"rig logs: {catalogue.cache_trouble}")
    for trouble in catalogue.unread_folders:
        notify(f"rig logs: {trouble}")
    if json:
        print_json(
            {
                "folder": str(folder),
                "files": len(entries),
                "logs": [entry.model_dump() for entry in found],
                "unread_folders": catalogue.unread_folders,
            }
        )
    else:
        print_logs(found, len(entries), folder)
    return 0


def log(
    log: Path,
    *,
    verify: Annotated[bool, Parameter(negative="--no-verify")] = True,
    events: Flag = False,
    snapshot: Flag = False,
    plot: Path | None = None,
    force: Force = False,
    json: Json = False,
) -> int:
    """Show what is in one log, and check every byte of it.

    The exit code is 1 if the file is cut or damaged. Losses of a recovered log that occurred before its recovery
    are listed, but are no damage of this file.

    Example: `rig log run.mcap`

    Args:
        log: the log, finished or not.
        verify: read everything and check it; --no-verify trusts the file's summary.
        events: list every event; otherwise similar ones are grouped.
        snapshot: print only the rig file as it was when the log was recorded (TOML).
        plot: draw the whole log into this .svg, .png or .pdf file.
    """
    check_outputs("rig log: --plot", plot, force=force)
    from daq.log import open_log
    from rig_cli.log_facts import log_facts  # the log's reader takes half a second to import
    from rig_cli.log_page import print_log

    with open_log(log) as opened:
        if snapshot:
            return _print_snapshot(opened, json)
        found = None
        if verify:
            with share_progress(f"checking {log.name}") as progress:
                found = opened.verify(progress)
        facts = log_facts(opened, log, found, all_events=events)
        if plot is not None:
            _plot(opened, plot, facts)
    if json:
        print_json(facts)
    else:
        print_log(facts)
    damaged = verify and len(facts["missing"]) > len(facts["lost_before"])
    return 1 if damaged or facts["unreadable"] else 0


def _progress_when_called(stack: ExitStack, text: str) -> Callable[[float], None]:
    """Return a progress function that shows nothing until its first call."""
    opened: list[Callable[[float], None]] = []

    def progress(share: float) -> None:
        if not opened:
            opened.append(stack.enter_context(share_progress(text)))
        opened[0](share)

    return progress


def _print_snapshot(opened: Log, json: bool) -> int:
    from daq.log.snapshot import snapshot_of

    table = snapshot_of(opened)
    if json:
        print_json(table)
    else:
        import tomlkit

        print(tomlkit.dumps(_without_null(table)), end="")
    return 0


def _without_null(value: Any) -> Any:
    """Return a table without null values: TOML has none, and a missing key has the same meaning."""
    if isinstance(value, dict):
        table = cast("dict[str, Any]", value)
        return {key: _without_null(part) for key, part in table.items() if part is not None}
    if isinstance(value, list):
        return [_without_null(part) for part in cast("list[Any]", value) if part is not None]
    return value


def _plot(opened: Log, path: Path, facts: dict[str, Any]) -> None:
    from analysis.figures.log_overview import draw_log_overview  # matplotlib takes a second to import

    run = facts["run"]
    words = [Path(facts["log"]).name, *(run[key] for key in ("rig", "test") if run.get(key))]
    words += [local_time(run["started"])] if run.get("started") else []
    with share_progress(f"drawing {path.name}") as progress:
        draw_log_overview(opened, path, " · ".join(words), progress)
    notify(f"drawn: {path}")
