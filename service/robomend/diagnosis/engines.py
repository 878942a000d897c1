"""The engines by name. `make_engine("sat", cnf)` is how the rest of robomend gets one.

    sat      the default: persistent MiniSat-family solver; conflicts, cones, layered and core-guided search
    asp      clingo over encodings/diagnosis.lp
    maxsat   RC2, one MaxSAT call a diagnosis: a baseline
    hs_dag   Reiter's hitting-set DAG with a SAT oracle: a baseline

To add one of your own, write a class with the methods of `robomend.diagnosis.result.Engine`, constructed as
`YourEngine(cnf, solver=None)`, and name it in your distribution:

    [project.entry-points."robomend.engines"]
    mine = "my_package:YourEngine"

Our own names cannot be taken over. An engine that cannot honour an option must raise OptionRefused.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, cast

from robomend.diagnosis.result import Engine
from robomend.errors import OptionRefused, SolverError
from robomend.model.cnf import HealthCnf

GROUP = "robomend.engines"

BUILT_IN: dict[str, str] = {
    "sat": "robomend.diagnosis.sat:SatEngine",
    "asp": "robomend.diagnosis.asp:AspEngine",
    "maxsat": "robomend.diagnosis.maxsat:MaxSatEngine",
    "hs_dag": "robomend.diagnosis.hs_dag:HsDagEngine",
}

DEFAULT = "sat"


def engine_names() -> tuple[str, ...]:
    """Return the names that make_engine knows: ours, then those of third parties in alphabetical order."""
    others = {point.name for point in entry_points(group=GROUP)} - BUILT_IN.keys()
    return (*BUILT_IN, *sorted(others))


def make_engine(name: str, cnf: HealthCnf, *, solver: str | None = None) -> Engine:
    """Return a warm engine for one model.

    Args:
        name: one of `engine_names()`.
        cnf: the compiled model.
        solver: the solver inside the engine, None for the engine's own choice.

    Raises:
        OptionRefused: no engine has this name, or the engine cannot work with this solver.
        SolverError: a third party's engine could not be loaded.
    """
    if name in BUILT_IN:
        module, _, attribute = BUILT_IN[name].partition(":")
        made: Any = getattr(import_module(module), attribute)(cnf, solver=solver)
    else:
        made = _third_party(name)(cnf, solver=solver)
    return cast(Engine, made)


def _third_party(name: str) -> Any:
    points: tuple[EntryPoint, ...] = tuple(entry_points(group=GROUP, name=name))
    if not points:
        raise OptionRefused(f"no engine is named {name!r}: choose one of {', '.join(engine_names())}")
    try:
        return points[0].load()
    except (ImportError, AttributeError) as error:
        raise SolverError(f"engine {name!r} ({points[0].value}) could not be loaded: {error}") from error
