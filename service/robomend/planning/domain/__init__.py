"""PDDL: text to a checked domain, and its actions made ready for grounding."""
