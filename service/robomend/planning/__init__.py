"""From a diagnosis to a plan: domain, problem, planners, prediction, choice, policy."""
