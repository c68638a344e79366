"""What a whole run listens on: loopback, and beyond it the one address that it was asked to serve."""

import json
import re
import subprocess
import sys

import psutil

SERVED = "127.0.0.2"
"""Stands for an address of a network: it is none that anything binds to by itself."""


def bound(process):
    """(IP, port) of the TCP sockets that listen and the UDP sockets that take from anybody, of all of a run."""
    found = set()
    for p in (process, *process.children(recursive=True)):
        for c in p.net_connections("inet"):
            if c.status == psutil.CONN_LISTEN or (c.type.name == "SOCK_DGRAM" and not c.raddr):
                found.add((c.laddr.ip, c.laddr.port))
    return found


def test_nothing_but_the_served_page_is_off_loopback(tmp_path):
    words = [sys.executable, "-m", "station", "run", "bench", "--view", "web", "--json", "--log", str(tmp_path)]
    process = subprocess.Popen([*words, "--serve", SERVED], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        told = ""
        while "glance: " not in told:
            told += (line := process.stderr.readline())
            assert line, told
        viewer = {int(port) for port in re.findall(r"127\.0\.0\.1:(\d+)", told)}
        (port,) = (int(port) for port in re.findall(rf"glance: http://{SERVED}:(\d+)/\?token=", told))
        seen, links = set(), {}
        # Until the Rerun page is up, and every device has been heard over its link.
        while not viewer <= {p for _, p in seen} or not links or not all(x["alive"] for x in links.values()):
            links = json.loads(process.stdout.readline())["links"]
            seen = bound(psutil.Process(process.pid))
        assert len(viewer) == 2
        assert {ip for ip, _ in seen} == {"127.0.0.1", SERVED}
        assert [p for ip, p in seen if ip == SERVED] == [port]
    finally:
        process.kill()
        process.communicate()
