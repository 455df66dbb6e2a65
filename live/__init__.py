"""The live page: a rig or a log in a browser, with a stop button.

    rig ─▶ Session ─▶ beside.LivePage ══pipe══▶ the page's own process: watched.Watched ┐
    log ────────────────────────────────────────────────────────────▶ replayed.Replayed ┴▶ picture ─▶ server ─▶ browser

What is drawn is a `Source` (live.source): signals up to an instant, facts beside them, and what may be asked of it.
`guard` decides who gets anything. The recorder's process copies new samples into a pipe and does nothing else for it.
"""
