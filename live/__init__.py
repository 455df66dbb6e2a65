"""The live page: a rig or a log in a browser, with a stop button.

    rig ─▶ Session ─▶ session_page.LivePage ══pipe══▶ page process: watched.Watched ┐
    log ────────────────────────────────────────────────────────▶ replayed.Replayed ┴▶ picture ─▶ server ─▶ browser

    browser ─▶ entrance ─▶ STOP to the session; all other connections to the server

The page displays a `PageSource` (live.source): signals up to an instant, further facts, and the commands that it
accepts. `guard` checks every request, in `entrance`, which carries out STOP itself. The recorder's process copies new
samples into a pipe and does no other work for the page.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
