"""The `rig` command."""
from cyclopts import App
app = App(name="rig")

@app.command
def virtual(rig: str, *, time_scale: float = 1.0, link: str = "auto", set: list[str] = []):
    from daq.virtual_rig.run import serve
    from rig_configs import load_rig
    serve(load_rig(rig, settings=set), time_scale, link)

def main():
    app()
if __name__ == "__main__":
    main()
