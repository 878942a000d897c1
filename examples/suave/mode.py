"""Whether a system of system_modes was last asked for a mode."""


def is_mode(value: object, mode: str) -> bool:
    """Return whether the label of a ModeEvent's goal is this one."""
    return value == mode
