"""What is for circuits only: gates found again in the clauses, dominators and cones, simulation."""
