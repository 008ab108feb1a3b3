"""Print how many times slower this machine is than an ordinary one."""

import sys
import time

ROUNDS = 60
ORDINARY_S = 0.05  # of a round

begin = time.perf_counter()
for _ in range(ROUNDS):
    sum(number * number for number in range(1_000_000))
taken = (time.perf_counter() - begin) / ROUNDS
sys.stdout.write(f"{taken / ORDINARY_S:.0f}\n")
