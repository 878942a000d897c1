"""What robomend-batch takes, on logs of its own making: workload.py writes them, command.py measures."""
