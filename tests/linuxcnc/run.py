#!/usr/bin/python3
"""LinuxCNC's display: runs one program on the simulated machine and leaves what the servo loop recorded."""

import os
import subprocess
import sys
import time

import linuxcnc


def wait(what, until, seconds=60.0):
    end = time.monotonic() + seconds
    while not until():
        if time.monotonic() > end:
            sys.exit(f"LinuxCNC did not get to: {what}")
        time.sleep(0.01)


def recorded():
    """Number of the last sample that was written whole."""
    with open(os.environ["PROFILE_RECORD"], encoding="ascii") as record:
        lines = record.read().split("\n")[:-1]
    return int(lines[-1].split()[0]) if lines else -1


def main():
    command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()

    def now():
        status.poll()
        return status

    command.state(linuxcnc.STATE_ESTOP_RESET)
    command.wait_complete()
    command.state(linuxcnc.STATE_ON)
    command.wait_complete()
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.teleop_enable(0)
    command.wait_complete()
    for joint in range(3):
        command.home(joint)
    wait("homed", lambda: all(now().homed[:3]))
    command.mode(linuxcnc.MODE_MDI)
    command.wait_complete()
    command.mdi("G21 G90 G0 Z5")
    command.wait_complete(30)
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete()
    command.program_open(os.environ["PROFILE_PROGRAM"])
    with open(os.environ["PROFILE_RECORD"], "w", encoding="ascii") as record:
        recorder = subprocess.Popen(["halsampler", "-t"], stdout=record)
        command.auto(linuxcnc.AUTO_RUN, 0)
        wait("started", lambda: now().interp_state != linuxcnc.INTERP_IDLE)
        wait("ended", lambda: now().interp_state == linuxcnc.INTERP_IDLE, 120.0)
        # The recorder reads from a buffer in memory: the program's last sample is written a moment after its end.
        asked = subprocess.run(["halcmd", "getp", "sampler.0.sample-num"], check=True, capture_output=True, text=True)
        wait("recorded", lambda: recorded() >= int(asked.stdout))
        recorder.terminate()
        recorder.wait()
    error = errors.poll()
    if error:
        sys.exit(f"LinuxCNC says: {error[1]}")


main()
