"""The engines by name. `make_engine("sat", cnf)` is how the rest of robomend gets one.

    sat       the default: persistent MiniSat-family solver; conflicts, cones, layered and core-guided search
    asp       clingo over encodings/diagnosis.lp
    maxsat    RC2, one MaxSAT call a diagnosis: a baseline
    hs_dag    Reiter's hitting-set DAG with a SAT oracle: a baseline
    cda_star  conflict-directed A* over modes, the search of Livingstone: a baseline

To add an engine: 1. a class with the methods of `robomend.diagnosis.result.Engine`, constructed as
`YourEngine(cnf, solver=None)`, in a module of its own; 2. its line in ENGINES; 3. its row in
docs/diagnosis.md. An engine of your own needs no change here: its class, and in your distribution

    [project.entry-points."robomend.engines"]
    mine = "my_package:YourEngine"

An engine that cannot honour an option must raise OptionRefused.
"""

from __future__ import annotations

from typing import Protocol

from robomend.diagnosis.result import Engine
from robomend.errors import OptionRefused, SolverError
from robomend.model.cnf import HealthCnf
from robomend_client.registry import Registry


class EngineClass(Protocol):
    """What makes an engine for one model."""

    def __call__(self, cnf: HealthCnf, *, solver: str | None = None) -> Engine:
        """Return a warm engine; OptionRefused if it cannot work with this solver."""
        ...


ENGINES = Registry[EngineClass](
    "engine",
    "robomend.engines",
    {
        "sat": "robomend.diagnosis.sat:SatEngine",
        "asp": "robomend.diagnosis.asp:AspEngine",
        "maxsat": "robomend.diagnosis.maxsat:MaxSatEngine",
        "hs_dag": "robomend.diagnosis.hs_dag:HsDagEngine",
        "cda_star": "robomend.diagnosis.cda_star:CdaStarEngine",
    },
    unknown=OptionRefused,
    broken=SolverError,
)

DEFAULT = "sat"


def make_engine(name: str, cnf: HealthCnf, *, solver: str | None = None) -> Engine:
    """Return a warm engine for one model.

    Args:
        name: one of `ENGINES.names()`.
        cnf: the compiled model.
        solver: the solver inside the engine, None for the engine's own choice.

    Raises:
        OptionRefused: no engine has this name, or the engine cannot work with this solver.
        SolverError: a third party's engine could not be loaded.
    """
    return ENGINES.load(name)(cnf, solver=solver)
