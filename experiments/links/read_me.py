"""The page that goes along with the controller's files, for the person at the controller."""

from __future__ import annotations

from collections.abc import Sequence

from experiments.links.schema import ALIVE_FLAGS, DATA_FLAGS, RING, SAMPLE_MS, WATCHDOG_S

__all__ = ["read_me"]


def read_me(title: str, port: int, timers: tuple[int, int], limits: Sequence[str]) -> str:
    """Write it.

    Parameters
    ----------
    title
        Of the robot.
    port
        Of the motion channel.
    timers
        Numbers of $TIMER that the programs use.
    limits
        Of the axes, in words.
    """
    return f"""\
clampid: files for the controller of {title}

These programs were run against a virtual controller only, never on a real one.
Read them before you use them. You are responsible for the cell.

1. What must be installed
   KUKA.EthernetKRL 2.2 or later      for the motion and the state channel
   KUKA.RobotSensorInterface          only for ClampidRSI.xml (logging at 4 or 12 ms)

2. Where the files go
   ClampidMotion.xml, ClampidState.xml   C:\\KRC\\ROBOTER\\Config\\User\\Common\\EthernetKRL
   clampid_motion.src, clampid_motion.dat   KRC:\\R1\\Program
   clampid_state.sub                     KRC:\\R1\\System (start it as an additional submit interpreter,
                                         or call CLAMPID_STATE from it)
   ClampidRSI.xml                        C:\\KRC\\ROBOTER\\Config\\User\\Common\\SensorInterface
   Open the TCP ports {port} and {port + 1} of the controller's network settings (NAT) for this computer only.
   The channels have no password: whoever reaches the ports moves the robot. Use a network of its own.

3. What the programs use: check that nothing else does
   $FLAG[{ALIVE_FLAGS[0]}] to $FLAG[{DATA_FLAGS[1]}]; $TIMER[{timers[0]}] and $TIMER[{timers[1]}];
   interrupts 21, 22 and 23; $VEL_AXIS;
   about {RING * 20 * 4 / 1e6:.1f} MB for the recording ({RING} samples, one each {SAMPLE_MS} ms).

4. Axis limits in clampid_motion.dat [deg]; the controller's software limits are checked as well
   {"; ".join(limits)}

5. First try
   a. Start CLAMPID_STATE. On the computer: clampid serve MODEL.json --link eki://ADDRESS:{port}
      Ask for the state: joints, mode and brakes must be what the smartPAD shows.
   b. Set the program override to 1 %. Select CLAMPID_MOTION, start it in AUT: it stays where the robot is.
   c. Ask for a small move. Keep a hand on the stop. Then send stop: the robot must brake.
   d. Raise the override only after that.

6. When it stops
   Programs end, and none is taken up again by itself, when
   - anyone sends stop (a latch: moves are refused until a release);
   - nobody asked for the state for {WATCHDOG_S:g} s (the server or the network is gone);
   - there is an emergency stop, the mode is neither AUT nor EXT, or the drives go off.
   After an emergency stop reset CLAMPID_MOTION, select and start it again. Do not just press start.
   Each start raises the boot number. Moves of before are refused, and the computer asks a person to confirm.

7. Units: ask, then tell the suite
   $TORQUE_AXIS_ACT is Nm by some sources and % by others; $CURR_ACT is A or %. Look them up in the manual of your
   system software and add them to the link: eki://ADDRESS:{port}?torque=Nm&current=A
   Without that the suite says "unit unknown". Torques mean something only while the brakes are open.

8. RSI
   Build a signal flow in RSIVisual: an ETHERNET object with ClampidRSI.xml; a GEARTORQUE object for each axis, wired to
   its inputs 1 to 6. Put this computer's address into ClampidRSI.xml. ONLYSEND is TRUE: the stream moves nothing.
"""
