"""A rig or a log for Foxglove and Lichtblick: a read-only server of their WebSocket protocol.

    session ─▶ session_connection ─(pipe)─▶ served ─┐
    log ─────▶ played ──────────────────────────────┴─▶ server ─▶ clients, each with a queue of its own ─▶ protocol

The connection has no token, because the protocol has none: docs/decisions/0017-foxglove.md.
"""
