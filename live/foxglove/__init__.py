# pyright: strict
"""A rig or a log for Foxglove and Lichtblick: their WebSocket protocol, spoken by a server that only gives.

    session ─▶ beside ─(pipe)─▶ served ─┐
    log ─────▶ played ──────────────────┴─▶ server ─▶ clients, each with a queue of its own ─▶ protocol

It asks for no token, because the protocol has none: docs/decisions/0018-foxglove.md.
"""
