"""The methods by which a problem's parameters are estimated."""

from enum import StrEnum


class Method(StrEnum):
    """Names of methods, as estimates, tables and files have them.

    Examples
    --------
    >>> Method("constrained")
    'constrained'
    """

    AS_PUBLISHED = "least squares as published"
    AS_PUBLISHED_WITH_FRICTION = "least squares as published, with friction"
    LEAST_SQUARES = "least squares"
    WEIGHTED_LEAST_SQUARES = "weighted least squares"
    HUBER = "Huber"
    BOX_CONSTRAINED = "box-constrained QP"
    CONSTRAINED = "constrained"
    CONSTRAINED_WITH_FRICTION = "constrained, with friction"
    WEIGHTED_CONSTRAINED = "weighted constrained"
    CROSS_VALIDATED = "cross-validated"
    INSTRUMENTAL_VARIABLES = "instrumental variables"
    REFINED_BY_ROLLOUT = "refined by rollout"

    def __repr__(self) -> str:
        return repr(self.value)
