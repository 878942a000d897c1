"""A process that is there and says nothing: what a drill puts in a node's place.

    python -I -S stand_in.py SECONDS

It imports nothing of ours, so that it is there at once, and ends by itself after SECONDS: nobody is left
standing whose agent cannot end it any more.
"""

import sys
import time

if __name__ == "__main__":
    time.sleep(float(sys.argv[1]))
