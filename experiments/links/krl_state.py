"""KRL of the state channel: the submit interpreter answers, records and watches, also while the robot moves."""

from __future__ import annotations

from collections.abc import Iterator

from experiments.links.eki_config import REOPEN_MS
from experiments.links.krl_motion import CLOCK_TIMER, WATCHDOG_TIMER, head, reopened
from experiments.links.schema import (
    ALIVE_FLAGS,
    AXES,
    RING,
    SAMPLE_MS,
    SAMPLES,
    STATE,
    WATCHDOG_S,
    Element,
    Kind,
    Mode,
    Reason,
)

__all__ = ["state_sub"]

CLOCK_FULL_MS = 2_000_000_000  # 23.1 days; the greatest INT is 2_147_483_647
LAST = STATE.receive[-1].tag
_STATE = {
    "Sequence": "SEQ", "Boot": "CL_BOOT", "Accepted": "CL_ACCEPTED", "Running": "CL_RUNNING",
    "Finished": "CL_FINISHED", "Aborted": "CL_ABORTED", "Point": "CL_POINT", "Reason": "CL_REASON",
    "Stopped": "CL_STOPPED", "Mode": "MODENO", "Drives": "$PERI_RDY", "Brakes": "RELEASED", "Estop": "ESTOP",
    "Clock": f"$TIMER[{CLOCK_TIMER}]", "Oldest": "OLDEST", "Newest": "CL_NEWEST",
}  # fmt: skip
_ROWS = {"N": "CL_RN", "T": "CL_RT", "Q": "CL_RQ", "M": "CL_RM", "I": "CL_RI"}


def state_sub(title: str) -> str:
    """The program that the submit interpreter runs.

    Parameters
    ----------
    title
        Of the robot.
    """
    lines = [
        *head("CLAMPID_STATE", title, "clampid: answers, records, watches"),
        "DEF CLAMPID_STATE ( )",
        "DECL EKI_STATUS RET",
        "DECL INT DUE,ASKED,SEQ,KIND,SINCE,MODENO,OLDEST,COUNT,ROW,K,WHY,OPENED",
        "DECL BOOL RELEASED,ESTOP",
        "IF CL_RUNNING>0 THEN",
        "; this program was started again while the robot moves: nobody watched, so it stops",
        f"CL_WHY={Reason.WATCHDOG:d}",
        "CL_BRAKE=TRUE",
        "ENDIF",
        *_begun(),
        f"$TIMER_STOP[{CLOCK_TIMER}]=FALSE",
        "COUNT=-1",
        *reopened(STATE.name),
        f"OPENED=$TIMER[{CLOCK_TIMER}]",
        "LOOP",
        *_renewed(),
        *_sampled(),
        *_watched(),
        f"IF $FLAG[{ALIVE_FLAGS[1]}]==FALSE THEN",
        f"IF (COUNT>=0) OR ($TIMER[{CLOCK_TIMER}]-OPENED>{REOPEN_MS}) THEN",
        "; the client is gone, or the time-out of the config file will end the listening: open the channel again",
        *reopened(STATE.name),
        f"OPENED=$TIMER[{CLOCK_TIMER}]",
        "COUNT=-1",
        "ENDIF",
        "ELSE",
        "COUNT=0",
        f'RET=EKI_CheckBuffer("{STATE.name}","{LAST}")',
        "IF RET.Buff>0 THEN",
        *(
            f'RET=EKI_GetInt("{STATE.name}","{element.tag}",{into})'
            for element, into in zip(STATE.receive, ("SEQ", "KIND", "SINCE"), strict=True)
        ),
        f"ASKED=$TIMER[{CLOCK_TIMER}]",
        f"$TIMER[{WATCHDOG_TIMER}]=-{WATCHDOG_S * 1000:.0f}",
        f"IF KIND=={Kind.STOP:d} THEN",
        "CL_STOPPED=TRUE",
        "IF CL_RUNNING>0 THEN",
        f"CL_WHY={Reason.STOPPED:d}",
        "CL_BRAKE=TRUE",
        "ENDIF",
        "ENDIF",
        f"IF (KIND=={Kind.RELEASE:d}) AND (CL_RUNNING==0) AND $ROB_STOPPED THEN",
        "CL_STOPPED=FALSE",
        "ENDIF",
        *_answered(),
        "ENDIF",
        "ENDIF",
        "ENDLOOP",
        "END",
    ]
    return "\r\n".join(lines) + "\r\n"


def _begun() -> Iterator[str]:
    """Numbers, recording, stop latch and clock begin anew, under another boot number."""
    yield "CL_BOOT=CL_BOOT+1"
    for name in ("ACCEPTED", "FINISHED", "ABORTED", "POINT", "REASON"):
        yield f"CL_{name}=0"
    yield "CL_STOPPED=FALSE"
    yield "CL_NEWEST=0"
    yield f"$TIMER[{CLOCK_TIMER}]=0"
    yield "DUE=0"
    yield "ASKED=0"


def _renewed() -> Iterator[str]:
    """An INT of milliseconds is full after 24.8 days, and an overflow would end this program."""
    yield f"IF ($TIMER[{CLOCK_TIMER}]>{CLOCK_FULL_MS}) AND (CL_RUNNING==0) THEN"
    yield "; the timer is nearly full: begin anew, as after a start"
    yield from _begun()
    yield "OPENED=0"
    yield "ENDIF"


def _sampled() -> Iterator[str]:
    """Every 12 ms one sample goes into the ring buffer; its number counts on for ever."""
    yield f"IF $TIMER[{CLOCK_TIMER}]>=DUE THEN"
    yield f"DUE=$TIMER[{CLOCK_TIMER}]+{SAMPLE_MS}"
    yield f"ROW=CL_NEWEST-(CL_NEWEST/{RING})*{RING}+1"
    yield "CL_RN[ROW]=CL_NEWEST+1"
    yield f"CL_RT[ROW]=$TIMER[{CLOCK_TIMER}]"
    for k in range(1, AXES + 1):
        yield f"CL_RQ[ROW,{k}]=$AXIS_ACT_MEAS.A{k}"
    yield f"FOR K=1 TO {AXES}"
    yield "CL_RM[ROW,K]=$TORQUE_AXIS_ACT[K]"
    yield "CL_RI[ROW,K]=$CURR_ACT[K]"
    yield "ENDFOR"
    yield "; the number is raised last: what it counts is whole"
    yield "CL_NEWEST=CL_NEWEST+1"
    yield "ENDIF"


def _watched() -> Iterator[str]:
    """What ends a program that runs: nobody asks, emergency stop, another mode, drives off."""
    yield "IF (CL_RUNNING>0) AND (CL_BRAKE==FALSE) THEN"
    yield "WHY=0"
    for condition, reason in (
        (f"$TIMER[{CLOCK_TIMER}]-ASKED>{WATCHDOG_S * 1000:.0f}", Reason.WATCHDOG),
        ("$PERI_RDY==FALSE", Reason.DRIVES_OFF),
        ("($MODE_OP<>#EX) AND ($MODE_OP<>#AUT)", Reason.MODE),
        ("$ALARM_STOP==FALSE", Reason.EMERGENCY_STOP),
        ("($PRO_STATE1==#P_FREE) OR ($PRO_STATE1==#P_RESET)", Reason.STOPPED),  # by a person, at the smartPAD
    ):
        yield f"IF {condition} THEN"
        yield f"WHY={reason:d}"
        yield "ENDIF"
    yield "IF WHY>0 THEN"
    yield "CL_WHY=WHY"
    yield "CL_BRAKE=TRUE"
    yield f"IF WHY<>{Reason.WATCHDOG:d} THEN"
    yield "; the controller itself has stopped the robot, and its interpreter with it: said from here"
    yield "CL_REASON=WHY"
    yield "CL_ABORTED=CL_RUNNING"
    yield "CL_RUNNING=0"
    yield "ENDIF"
    yield "ENDIF"
    yield "ENDIF"


def _answered() -> Iterator[str]:
    """One answer, with every element."""
    yield "SWITCH $MODE_OP"
    for name, mode in (("T1", Mode.T1), ("T2", Mode.T2), ("AUT", Mode.AUT), ("EX", Mode.EXT)):
        yield f"CASE #{name}"
        yield f"MODENO={mode:d}"
    yield "ENDSWITCH"
    yield "RELEASED=$BRAKE_SIG<>0"
    yield "ESTOP=NOT $ALARM_STOP"
    yield f"OLDEST=CL_NEWEST-{RING - 1}"
    yield "IF (OLDEST<1) AND (CL_NEWEST>0) THEN"
    yield "OLDEST=1"
    yield "ENDIF"
    yield "IF OLDEST<0 THEN"
    yield "OLDEST=0"
    yield "ENDIF"
    yield "COUNT=0"
    yield f"IF KIND=={Kind.RECORDING:d} THEN"
    yield "IF SINCE<OLDEST THEN"
    yield "SINCE=OLDEST"
    yield "ENDIF"
    yield "COUNT=CL_NEWEST-SINCE+1"
    yield "IF COUNT<0 THEN"
    yield "COUNT=0"
    yield "ENDIF"
    yield f"IF COUNT>{SAMPLES} THEN"
    yield f"COUNT={SAMPLES}"
    yield "ENDIF"
    yield "ENDIF"
    for element in STATE.send:
        at = element.tag.split("/")[1]
        if at in ("State", "Axis", "Torque", "Current", "Temperature", "Samples"):
            yield _set(element, _value(element))
    for k in range(1, SAMPLES + 1):
        yield f"IF COUNT>={k} THEN"
        yield f"ROW=SINCE+{k - 1}-1"
        yield f"ROW=ROW-(ROW/{RING})*{RING}+1"
        for element in (e for e in STATE.send if e.tag.split("/")[1] == f"S{k}"):
            yield _set(element, _value(element))
        yield "ENDIF"
    yield f'RET=EKI_Send("{STATE.name}","{STATE.send[0].root}")'


def _value(element: Element) -> str:
    """What KRL expression an element of the answer is set to."""
    _, at, name = element.tag.split("/")
    name = name[1:]
    plain = {
        "State": _STATE.get(name, ""),
        "Axis": f"$AXIS_ACT_MEAS.{name}",
        "Torque": f"$TORQUE_AXIS_ACT[{name[1:]}]",
        "Current": f"$CURR_ACT[{name[1:]}]",
        "Temperature": f"$MOT_TEMP[{name[1:]}]",
        "Samples": "COUNT",
    }
    if at in plain:
        return plain[at]
    return f"{_ROWS[name[0]]}[ROW{f',{name[1:]}' if name[1:] else ''}]"


def _set(element: Element, value: str) -> str:
    verb = {"INT": "SetInt", "REAL": "SetReal", "BOOL": "SetBool"}[element.type]
    return f'RET=EKI_{verb}("{STATE.name}","{element.tag}",{value})'
