"""From a diagnosis to a verified repair: problem, plan, choice, policy, execution."""
