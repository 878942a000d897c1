"""What robomend-batch takes, on logs of its own making: workload.py writes them, command.py measures.

drives.py makes recordings of random robots, healthy and with planted faults; learning.py learns from them and
scores.
"""
