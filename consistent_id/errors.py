"""The errors a user can meet.

Each message says what was seen (file, row, joint, value, unit), what was
expected, and what to do about it.
"""


class ConsistentIdError(Exception):
    """Root of every error that the package raises on purpose."""


class ModelError(ConsistentIdError):
    """The robot's description cannot be used as it is."""


class RecordingError(ConsistentIdError):
    """A recording cannot be read, or holds values that no robot wrote."""


class ProblemError(ConsistentIdError):
    """A problem file, or a call, asks for something that makes no sense."""


class NotExcitedError(ConsistentIdError):
    """The motion carries no information on what is asked for."""


class InfeasibleError(ConsistentIdError):
    """No parameters satisfy the constraints that were asked for."""


class SolverError(ConsistentIdError):
    """A numerical solver ended without a usable answer."""
