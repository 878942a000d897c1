"""Questions without a robot, and what-if: for the commands, the service, the benchmarks and logs alike.

text ──► question ──► result ──► JSON
warm_model.py              result_json.py, plan_json.py     values only, no event loop
solvers.py, oneshots.py       the same in worker processes, with places for those who wait
"""
