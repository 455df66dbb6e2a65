"""Commands about identified parameters: show a file, compare two, follow them over time."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from rig_basics.texts import number_of
from rig_cli.console import notify, print_json
from rig_cli.numbers import Chance
from rig_cli.option_groups import OUTPUT
from rig_cli.options import Force, Json, check_outputs
from rig_cli.parameters_budget import budget
from rig_cli.plan import share
from rig_configs import PARAMETER_UNITS, IdentifiedParameters, ParametersFileError, Rig, RigFileError, load_rig
from rig_configs.values_in_use import values_in_use

if TYPE_CHECKING:
    from identification.compare import ParameterComparison
    from identification.history import History
    from identification.joint.limits import ParameterLimit

app: App = App(name="parameters")
app.command(budget)
_CORRELATED = 0.5
MassStd = Annotated[str, Parameter(help="relative standard uncertainty of the masses, e.g. 0.05%")]


@app.command
def show(
    *files: Path,
    rig: Annotated[
        str | None, Parameter(help="also list all values in use with this rig, each with its origin")
    ] = None,
    mass_std: MassStd = "0%",
    json: Json = False,
) -> int:
    """Show parameters files: values, uncertainty, what limits them, which tests they came from, correlations.

    Example: `rig parameters show parameters.toml`

    Args:
        files: parameters.toml files.
    """
    if not files:
        raise RigFileError("no file given; usage: rig parameters show FILE…")
    mass = share(mass_std, "rig parameters show: --mass-std")
    loaded = None if rig is None else load_rig(rig)
    shown = [_facts(path, mass) | _in_use(path, loaded) for path in files]
    if json:
        print_json({"files": shown})
        return 0
    from rig_cli.parameters_page import print_parameters

    for facts in shown:
        print_parameters(facts)
    return 0


@app.command
def diff(
    old: Path,
    new: Path,
    *,
    level: Annotated[Chance, Parameter(help="probability of marking any change if there is none")] = 0.01,
    json: Json = False,
) -> int:
    """Compare two parameters files: what changed, by how much, and whether that is significant.

    Example: `rig parameters diff before.toml after.toml`

    Args:
        old: the parameters before.
        new: the parameters after.
    """
    from identification.compare import compare_parameters  # scipy and numba take seconds to import

    if not 0 < level < 1:
        raise RigFileError(f"rig parameters diff: --level expected a chance between 0 and 1, got {level:g}")
    found = compare_parameters(_load(old), _load(new))
    words = found.in_words(level)
    if json:
        print_json({"old": str(old), "new": str(new), "level": level, "words": words, **comparison_json(found)})
        return 0
    from rig_cli.parameters_page import print_comparison

    print_comparison(found, words, level)
    return 0


@app.command
def history(
    *places: Path,
    rig: Annotated[str | None, Parameter(help="only files of this rig")] = None,
    plot: Annotated[Path | None, Parameter(group=OUTPUT, help="draw it: .svg, .png or .pdf")] = None,
    level: Annotated[Chance, Parameter(help="probability of marking any change if there is none")] = 0.01,
    force: Force = False,
    json: Json = False,
) -> int:
    """Follow a rig's parameters over its parameters files, with each log's own values and the changes marked.

    Example: `rig parameters history campaigns --plot history.svg`

    Args:
        places: parameters files, and folders that are searched for them. A log is included after it is identified.
    """
    from identification.compare import compare_parameters  # scipy and numba take seconds to import
    from identification.history import parameter_history as follow

    if plot is not None:
        check_outputs("rig parameters history: --plot", plot, force=force)
    found = follow(list(places) or [Path()], rig)
    if plot is not None:
        from analysis.figures.style import save  # matplotlib is slow
        from rig_cli.history_figure import history_figure

        save(plot, history_figure(found, level))
    first, last = found.instants[0], found.instants[-1]
    overall = None
    if len(found.instants) > 1 and set(first.parameters.values) & set(last.parameters.values):
        overall = compare_parameters(first.parameters, last.parameters).in_words(level)
    if json:
        print_json(_history_json(found, overall, plot))
        return 0
    from rig_cli.parameters_page import print_history

    print_history(found, overall, level)
    if found.skipped:
        notify(f"{number_of(len(found.skipped), 'other TOML file is', 'other TOML files are')} not parameters files")
    if plot is not None:
        notify(f"drawn: {plot}")
    return 0


def _load(path: Path) -> IdentifiedParameters:
    try:
        return IdentifiedParameters.load(path)
    except ParametersFileError as fault:
        if str(fault).startswith(str(path)):
            raise
        raise ParametersFileError(f"{path}: {fault}") from fault


def _in_use(path: Path, rig: Rig | None) -> dict[str, Any]:
    """Return all values in use with a rig; empty without one."""
    if rig is None:
        return {}
    return {"in_use": {each.name: asdict(each) for each in values_in_use(rig, _load(path))}}


def _facts(path: Path, mass_std: float) -> dict[str, Any]:
    from identification.joint.limits import limits  # scipy and numba take seconds to import

    parameters = _load(path)
    try:
        found = limits(parameters, mass_std)
    except ParametersFileError as fault:
        raise ParametersFileError(f"{path}: {fault}") from fault
    limited = {limit.name: limit for limit in found or []}
    tests = parameters.provenance.get("tests", [])
    values = {
        name: {
            "value": value,
            "std": limited[name].std if name in limited else parameters.std[name],
            "relative_std": (limited[name].std if name in limited else parameters.std[name]) / abs(value),
            "unit": PARAMETER_UNITS[name],
            "tests": [t.get("test", "?") for t in tests if name in t.get("values", {}) and not _out(t, name, tests)],
            "limited_by": limit_json(limited[name]) if name in limited else None,
        }
        for name, value in parameters.values.items()
    }
    names, correlation = list(parameters.values), parameters.correlation
    pairs = [
        {"between": [names[i], names[j]], "correlation": float(correlation[i, j])}
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > _CORRELATED
    ]
    return {
        "file": str(path),
        "rig": parameters.provenance.get("rig"),
        "software": parameters.provenance.get("software"),
        "method": parameters.provenance.get("method"),
        "parameters": values,
        "correlated": pairs,
        "tests": [
            {key: t[key] for key in ("test", "log", "digest", "recorded", "method", "left_out") if key in t}
            for t in tests
        ],
        "keeps_its_tests": found is not None,
    }


def _out(test: dict[str, Any], name: str, tests: list[dict[str, Any]]) -> bool:
    """Return whether a test's value is left out: the test is bad, and another one shows the parameter."""
    return "left_out" in test and any(name in t.get("values", {}) for t in tests if "left_out" not in t)


def limit_json(limit: ParameterLimit) -> dict[str, Any]:
    """Return the main source, the share of each source, and advice."""
    return {"main": limit.main, "shares": limit.shares, "advice": limit.advice}


def comparison_json(found: ParameterComparison) -> dict[str, Any]:
    """Return the numbers of `rig parameters diff --json`."""
    return {
        "changes": {
            c.name: {
                "old": c.old,
                "new": c.new,
                "change": c.change,
                "std": c.std,
                "relative_change": c.relative,
                "relative_std": c.relative_std,
                "z": c.z,
                "p": c.p,
                "p_all_looks_counted": c.p_holm,
                "significant_at": c.level,
                "share_of_chi2": c.share,
                "unit": PARAMETER_UNITS[c.name],
            }
            for c in found.changes
        },
        "covariance": {"order": [c.name for c in found.changes], "matrix": found.covariance.tolist()},
        "overall": {"chi2": found.chi2, "dof": found.dof, "p": found.p},
        "only_old": found.only_old,
        "only_new": found.only_new,
        "notes": found.notes,
    }


def _history_json(found: History, overall: str | None, plot: Path | None) -> dict[str, Any]:
    return {
        "instants": [
            {
                "file": str(i.path),
                "time": i.time.isoformat(),
                "time_known": i.time_known,
                "rig": i.rig or None,
                "parameters": {
                    n: {"value": v, "std": i.parameters.std[n], "unit": PARAMETER_UNITS[n]}
                    for n, v in i.parameters.values.items()
                },
                "change": None if step is None else comparison_json(step),
            }
            for i, step in zip(found.instants, found.steps, strict=True)
        ],
        "first_to_last": overall,
        "skipped": found.skipped,
        "plot": None if plot is None else str(plot),
    }
