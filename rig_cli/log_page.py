"""Page of one log on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, cast

from rich.text import Text

from daq.items import LOSS_KINDS, loss_words
from daq.log.content import seconds
from daq.log.outcome import not_reached
from rig_basics.texts import number_of
from rig_cli.log_table import STATES, VERDICTS
from rig_cli.trip_page import trip_lines
from rig_cli.words import length, local_time, printable, size, stdout_console


def print_log(facts: Mapping[str, Any]) -> None:
    """Print one log's page on standard output."""
    console = stdout_console()
    for name, text, style in _lines(facts):
        console.print(Text.assemble((f"{name:13}", "dim"), (printable(text), style)), soft_wrap=True)
    console.print(printable(log_sentence(facts)), soft_wrap=True, markup=False)


def log_sentence(facts: Mapping[str, Any]) -> str:
    """Return whether the log is whole, what was lost in it, and what to do if it is not whole."""
    (_, lost, _), *_ = _loss_lines(facts["losses"])
    text = f"The log is {_state(facts)[0]}; {'' if lost.startswith(_NOTHING_LOST) else 'losses: '}{lost}"
    is_cut = len(facts["missing"]) > len(facts["lost_before"])
    return f"{text}; next: rig recover {facts['log']}." if is_cut else f"{text}."


def _lines(facts: Mapping[str, Any]) -> Iterable[tuple[str, str, str]]:
    """Return the lines as (name, text, style)."""
    run = facts["run"]
    yield "log", facts["log"], "bold"
    yield "state", *_state(facts)
    for what, style in (("missing", "red"), ("unchecked", "yellow"), ("unreadable", "red")):
        yield from ((f"  {what}", text, style) for text in facts[what])
    yield "recorded", ", ".join(_recorded(facts)), ""
    for name in ("rig", "test", "point", "note", "parameters", "software"):
        if run.get(name):
            yield name, run[name], ""
    if facts["origin"]:
        yield "origin", facts["origin"], ""
    others = {k: v for k, v in run.items() if k not in _RUN_SHOWN}
    for title, table in (("run", others), ("outcome", facts["outcome"])):
        if table:
            yield title, ", ".join(f"{name} {value}" for name, value in table.items()), ""
    yield from _judged(facts)
    yield from _loss_lines(facts["losses"])
    yield from _channel_lines(facts)
    yield from _health_lines(facts["health"])
    yield from _event_lines(facts)
    for trip in facts["trips"]:
        yield from trip_lines(trip, facts["start_ns"])
    for device, identity in facts["devices"].items():
        items: Iterable[tuple[str, Any]] = [("reports", identity)]
        if isinstance(identity, Mapping):
            items = cast("Mapping[str, Any]", identity).items()
        yield "device", f"{device}: " + ", ".join(f"{name} {value}" for name, value in items), ""
    for device, words in facts["sensors"].items():
        yield "sensor", f"{device}: measures {words}", ""
    for name, value in _flat(facts["rig"]["physical"]):
        yield "physical", f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}", ""
    if facts["attachments_bytes"]:
        yield "attachments", ", ".join(f"{name} ({size(n)})" for name, n in facts["attachments_bytes"].items()), ""


_NOTHING_LOST = "nothing lost"
_RUN_SHOWN = ("rig", "test", "point", "note", "parameters", "software", "origin", "started")


def _judged(facts: Mapping[str, Any]) -> Iterable[tuple[str, str, str]]:
    """Return lines about what the test did not reach, and about the last validation's verdict."""
    if missed := not_reached(facts["run"].get("test", ""), facts["outcome"]):
        yield "not reached", missed, "bold red"
    if facts["verdict"]:
        yield "verdict", *_verdict(facts["verdict"])


def _state(facts: Mapping[str, Any]) -> tuple[str, str]:
    word, style = STATES[facts["state"]]
    word = "cut, or still being recorded" if facts["state"] == "unfinished" else word
    checked = "every byte checked" if facts["verified"] else "not verified"
    if len(facts["missing"]) > len(facts["lost_before"]):
        return f"{word}, not whole", "bold red"
    if facts["lost_before"]:
        return f"{word}, not whole; of what it holds {checked}", "bold yellow"
    return f"{word}, {checked}", style


def _recorded(facts: Mapping[str, Any]) -> Iterable[str]:
    if started := facts["run"].get("started"):
        yield local_time(started)
    yield length(facts["duration_s"])
    yield f"{size(facts['size_bytes'])} in {number_of(facts['chunks'], 'chunk')}"
    if facts["library"]:
        yield f"written by {facts['library']}"


def _verdict(verdict: Mapping[str, Any]) -> tuple[str, str]:
    why = ", ".join(filter(None, (verdict["point"] and f"point {verdict['point']}", verdict["state"], verdict["why"])))
    if verdict["stale"]:
        return f"stale: {verdict['verdict']} is the verdict on another log ({why})", "yellow"
    return f"{verdict['verdict']} ({why})", VERDICTS.get(verdict["verdict"], "bold red")


def _loss_lines(losses: Mapping[str, Any] | None) -> Iterable[tuple[str, str, str]]:
    if losses is None:
        yield "losses", "unknown: it counts none", "yellow"
        return
    source = {"summary": "", "health": " (up to its last health report)", "events": " (by its events)", "none": ""}
    counts = [
        f"{device} {loss_words(n, kind)}"
        for device, kinds in losses["by_device"].items()
        for kind, n in kinds.items()
        if n
    ]
    text = ", ".join(counts) or _NOTHING_LOST
    yield "losses", text + source[losses["source"]], "bold red" if losses["total"] else "green"
    for device, kinds in losses["events"].items():
        counted = [
            f"{kind} {number_of(loss['events'], 'time')}, {loss['span_s']:.6g} s" for kind, loss in kinds.items()
        ]
        yield "", f"{device}: {'; '.join(counted)}", "red"


def _channel_lines(facts: Mapping[str, Any]) -> Iterable[tuple[str, str, str]]:
    for topic, channel in facts["channels"].items():
        if channel:
            text = (
                f"{topic:12}{number_of(channel['samples'], 'sample ', 'samples', '12,d')} {channel['span_s']:11.3f} s "
                f"{channel['rate_Hz']:10.2f} Hz"
            )
            yield "channel", text.replace(",", " "), ""
    for topic, count in facts["foreign_topics"].items():
        yield "topic", f"{topic:12}{number_of(count, 'message', form='12,d')} of another program".replace(",", " "), ""
    for device, raw in facts["raw"].items():
        if raw:
            ways = "" if raw["bytes_in"] is None else f", {size(raw['bytes_in'])} in, {size(raw['bytes_out'])} out"
            calls = number_of(raw["messages"], "read or write", "reads and writes", "12,d")
            yield (
                "raw",
                f"{device:12}{calls.replace(',', ' ')}{ways}",
                "",
            )


def _health_lines(health: Mapping[str, Any] | None) -> Iterable[tuple[str, str, str]]:
    if health is None:
        return
    disk = health.get("disk")
    slow_s = seconds(cast("Mapping[str, Any]", disk), "slow_s") if isinstance(disk, Mapping) else 0.0
    if slow_s > 0:
        text, style = f"the disk was behind for {slow_s:.1f} s", "yellow"
    elif health.get("stalled"):
        text, style = f"writing stalled {number_of(health['stalled'], 'time')}", "yellow"
    else:
        text, style = "the disk kept up", ""
    yield "health", f"last report at {health['time_s']:.1f} s: {text}", style


def _event_lines(facts: Mapping[str, Any]) -> Iterable[tuple[str, str, str]]:
    if "all_events" in facts:
        for event in facts["all_events"]:
            time_s = (event["time_ns"] - facts["start_ns"]) * 1e-9
            device, kind, text = (str(event.get(name, "")) for name in ("device", "kind", "text"))
            yield "event", f"{time_s:11.3f} s  {device:10} {kind:12} {text}", _event_style(kind)
        return
    for line in facts["events_alike"]:
        text = f"{line['first_s']:11.3f} s  {line['device']:10} {line['kind']:12} {line['text']}"
        if line["count"] > 1:
            text += f"  … {line['count']} like it until {line['last_s']:.3f} s"
        yield "event", text, _event_style(line["kind"])
    if facts["events_alike_left_out"]:
        yield "event", f"{facts['events_alike_left_out']} of other kinds; --events lists every one", "yellow"


def _event_style(kind: str) -> str:
    return "red" if kind in (*LOSS_KINDS, "fault", "restart", "emergency", "disk", "stop", "trip") else ""


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(cast("Mapping[str, Any]", value), f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
