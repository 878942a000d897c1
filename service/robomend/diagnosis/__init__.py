"""From a system description and OBS to minimal diagnoses, conflicts, explanations, ranking and probes."""
