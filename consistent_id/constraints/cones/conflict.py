"""Which constraints cannot hold together: an irreducible set of them.

Members are left out one after another for as long as what remains is proven empty
[Chinneck2008]_; of those that are left, each is needed for the contradiction, and
leaving out any one of them resolves it.
"""

from consistent_id.constraints.cones.feasibility import find_interior
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.errors import SolverError


def irreducible_conflict(domain: ConicSet) -> tuple[int, ...]:
    """Return members that contradict each other, none of them superfluous.

    Parameters
    ----------
    domain : ConicSet
        Normalised.

    Returns
    -------
    tuple of int
        Counted as in `ConicSet.labels`; empty if no contradiction is proven.
    """
    if not _proven_empty(domain):
        return ()
    kept = list(range(len(domain.labels)))
    for member in reversed(range(len(domain.labels))):
        fewer = [m for m in kept if m != member]
        if _proven_empty(domain.only(fewer)):
            kept = fewer
    return tuple(kept)


def _proven_empty(domain: ConicSet) -> bool:
    try:
        return find_interior(domain).proves_empty
    except SolverError:
        return False
