"""What robomend-batch takes, on logs of its own making: command.py makes and measures them.

drives.py makes recordings of random robots, healthy and with planted faults; learning.py learns from them and
scores.
"""
