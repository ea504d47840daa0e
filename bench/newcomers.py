"""`python -m bench.newcomers COUNT`: how long nodes that come beside an older one are unknown to it, in ms, as JSON.

Newcomers are processes of their own, one at a time, as a front that comes back is. What is timed begins when the last
of a newcomer's endpoints is made.
"""

import json
import sys
import time

import rclpy
from rclpy.node import Node
from waiting import ready_process, until

ENDPOINTS = 8
"""Services of a newcomer."""
NEWCOMER = """
import sys, time, rclpy
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("newcomer")
services = [node.create_service(Trigger, name, lambda _, answer: answer) for name in sys.argv[1:]]
made_s = time.monotonic()
print("ready", made_s, sep="\\n", flush=True)
sys.stdin.read()
"""


def unknown_ms(older: Node, turn: int) -> float:
    """How long one newcomer's last service was not known to the older node."""
    names = [f"/newcomer_{turn}/service_{n}" for n in range(ENDPOINTS)]
    with ready_process("-c", NEWCOMER, *names) as newcomer:
        made_s = float(newcomer.stdout.readline())
        until(lambda: older.count_services(names[-1]), "a newcomer that is known")
        return 1e3 * (time.monotonic() - made_s)


if __name__ == "__main__":
    rclpy.init()
    older_one = rclpy.create_node("older")
    print(json.dumps([unknown_ms(older_one, turn) for turn in range(int(sys.argv[1]))]))
