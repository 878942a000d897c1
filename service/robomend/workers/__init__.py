"""Warm, killable processes for calls that must not hold the service up.

process.py   one process: the parent's end, and the program that it runs
pool.py      several: lazily started, one spare kept ready, killed at a deadline
solvers.py   diagnoses in them, with the engine of a model kept warm where it was last used
"""
