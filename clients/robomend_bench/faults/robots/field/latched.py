"""An observer of one's own: a latched topic is there as soon as it was heard once."""


def heard(value: object) -> bool:
    """Whatever was heard is good news."""
    return True
