"""Warm, killable processes for calls that must not hold the service up.

process.py   one process: the parent's end, and the program that it runs
parent.py    no process outlives the one that started it
pool.py      several: lazily started, one spare kept ready, killed at a deadline
"""
