"""KRL of the motion channel: collects a program, checks it, moves, answers; and the data both interpreters share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from experiments.links.eki_config import REOPEN_MS
from experiments.links.schema import (
    ALIVE_FLAGS,
    AXES,
    LONGEST_PROGRAM,
    MOTION,
    RING,
    WATCHDOG_S,
    Element,
    Event,
    Reason,
)
from kinematics.escaping import for_krl

__all__ = ["CLOCK_TIMER", "WATCHDOG_TIMER", "head", "motion_dat", "motion_src", "reopened"]

CLOCK_TIMER, WATCHDOG_TIMER = 19, 20
"""$TIMER: of the samples; of the watchdog, which runs out by itself where the submit interpreter has stopped."""
BRAKE_INTERRUPT, WATCHDOG_INTERRUPT, ALIVE_INTERRUPT = 21, 22, 23
LAST = MOTION.receive[-1].tag  # the last element: once it has come, the document is complete


def head(name: str, title: str, what: str) -> list[str]:
    """The lines that a KRL file begins with."""
    return [
        "&ACCESS RVP",
        "&REL 1",
        "&PARAM EDITMASK = *",
        f"&COMMENT {for_krl(what)}",
        f"; {name}: written by clampid link-files for {for_krl(title)}",
    ]


def motion_dat(title: str, lower: Sequence[float], upper: Sequence[float]) -> str:
    """The data list: limits, and what the two interpreters tell each other.

    Parameters
    ----------
    title
        Of the robot.
    lower, upper
        Axis limits (6), deg.
    """
    bounds = [
        f"CL_{side}[{k}]={value:.4f}"
        for side, values in (("MIN", lower), ("MAX", upper))
        for k, value in enumerate(values, 1)
    ]
    lines = [
        *head("CLAMPID_MOTION", title, "clampid: moves the robot"),
        "DEFDAT CLAMPID_MOTION PUBLIC",
        "; raised at each start of a program, kept over restarts",
        "DECL GLOBAL INT CL_BOOT=0",
        "; programs, by their numbers: 0 is none",
        *(f"DECL GLOBAL INT CL_{name}=0" for name in ("ACCEPTED", "RUNNING", "FINISHED", "ABORTED", "POINT", "REASON")),
        "; why the submit interpreter wants a stop; the brake; the latch that only a release lifts",
        "DECL GLOBAL INT CL_WHY=0",
        "DECL GLOBAL BOOL CL_BRAKE=FALSE",
        "DECL GLOBAL BOOL CL_STOPPED=FALSE",
        "; the program that is being collected",
        *(f"DECL INT CL_{name}=0" for name in ("ID", "HAVE", "WANT", "BAD", "GOT_BOOT", "GOT_POINT", "GOT_COUNT")),
        "DECL INT CL_GOT_ID=0",
        "DECL INT CL_MY_BOOT=0",
        "DECL INT CL_WAITED=0",
        "DECL REAL CL_GOT_SPEED=0.0",
        "DECL AXIS CL_GOT={A1 0.0,A2 0.0,A3 0.0,A4 0.0,A5 0.0,A6 0.0}",
        f"DECL AXIS CL_TARGET[{LONGEST_PROGRAM}]",
        f"DECL REAL CL_SPEED[{LONGEST_PROGRAM}]",
        "; axis limits of the description, deg",
        f"DECL REAL CL_MIN[{AXES}]",
        f"DECL REAL CL_MAX[{AXES}]",
        *bounds,
        "; ring buffer of the recording: number, ms, deg, torque, current",
        f"DECL GLOBAL INT CL_RING={RING}",
        "DECL GLOBAL INT CL_NEWEST=0",
        *(f"DECL GLOBAL INT CL_R{letter}[{RING}]" for letter in "NT"),
        *(f"DECL GLOBAL REAL CL_R{letter}[{RING},{AXES}]" for letter in "QMI"),
        "ENDDAT",
    ]
    return _text(lines)


def motion_src(title: str) -> str:
    """The program that the robot interpreter runs."""
    alive, timer = ALIVE_FLAGS[0], WATCHDOG_TIMER
    lines = [
        *head("CLAMPID_MOTION", title, "clampid: moves the robot"),
        "DEF CLAMPID_MOTION ( )",
        "DECL EKI_STATUS RET",
        ";FOLD INI",
        "BAS (#INITMOV,0)",
        "$ADVANCE=0",
        ";ENDFOLD (INI)",
        "CL_BOOT=CL_BOOT+1",
        "CL_MY_BOOT=CL_BOOT",
        "CL_ACCEPTED=0",
        "CL_RUNNING=0",
        "CL_FINISHED=0",
        "CL_ABORTED=0",
        "CL_POINT=0",
        "CL_REASON=0",
        "CL_STOPPED=FALSE",
        "CL_BRAKE=FALSE",
        "CL_DISCARD()",
        "; block coincidence: to where the robot is",
        *(f"CL_GOT.A{k}=$AXIS_ACT_MEAS.A{k}" for k in range(1, AXES + 1)),
        "PTP CL_GOT",
        "LOOP",
        f"IF $FLAG[{alive}]==FALSE THEN",
        "; the client is gone: what it had not sent to its end is discarded",
        "CL_DISCARD()",
        "CL_REOPEN()",
        "CL_WAITED=0",
        f"WHILE $FLAG[{alive}]==FALSE",
        "WAIT SEC 0.1",
        "CL_WAITED=CL_WAITED+1",
        f"IF CL_WAITED>={REOPEN_MS // 100} THEN",
        "; before the time-out of the config file ends the listening",
        "CL_REOPEN()",
        "CL_WAITED=0",
        "ENDIF",
        "ENDWHILE",
        "ENDIF",
        "IF CL_BOOT<>CL_MY_BOOT THEN",
        "; the submit program was started again: nothing of before counts",
        "CL_MY_BOOT=CL_BOOT",
        "CL_DISCARD()",
        "ENDIF",
        f'RET=EKI_CheckBuffer("{MOTION.name}","{LAST}")',
        "IF RET.Buff>0 THEN",
        "CL_TAKE()",
        "IF (CL_WANT>0) AND (CL_HAVE==CL_WANT) THEN",
        "CL_EXECUTE()",
        "ENDIF",
        "ELSE",
        "WAIT SEC 0.012",
        "ENDIF",
        "ENDLOOP",
        "END",
        "",
        "DEF CL_EXECUTE ( )",
        "; the program is whole: accept it or refuse it, all of it",
        "DECL INT WHY",
        "WHY=CL_MAY_MOVE()",
        "IF WHY>0 THEN",
        "CL_REFUSE(WHY)",
        "RETURN",
        "ENDIF",
        "CL_ACCEPTED=CL_ID",
        "CL_POINT=0",
        "CL_REASON=0",
        "CL_WHY=0",
        "CL_BRAKE=FALSE",
        f"$TIMER[{timer}]=-{WATCHDOG_S * 1000:.0f}",
        f"$TIMER_STOP[{timer}]=FALSE",
        "CL_RUNNING=CL_ID",
        f"CL_SAY({Event.ACCEPTED:d},CL_ID,0,0)",
        "; RESUME goes on behind the call out of the block that declares the interrupt: here, behind CL_MOVE_ALL",
        "; the brake flag of the submit interpreter, and the watchdog's timer where that has stopped",
        f"INTERRUPT DECL {BRAKE_INTERRUPT} WHEN CL_BRAKE==TRUE DO CL_HALT()",
        f"INTERRUPT DECL {WATCHDOG_INTERRUPT} WHEN $TIMER_FLAG[{timer}]==TRUE DO CL_STARVED()",
        f"INTERRUPT DECL {ALIVE_INTERRUPT} WHEN $FLAG[{alive}]==FALSE DO CL_REOPEN()",
        "CL_MOVE_ALL()",
        "; here after the last point, or after RESUME",
        f"$TIMER_STOP[{timer}]=TRUE",
        "IF CL_MY_BOOT<>CL_BOOT THEN",
        "CL_RUNNING=0",
        "CL_DISCARD()",
        "RETURN",
        "ENDIF",
        "IF (CL_POINT==CL_WANT) AND (CL_RUNNING==CL_ID) THEN",
        "CL_FINISHED=CL_ID",
        "CL_RUNNING=0",
        f"CL_SAY({Event.FINISHED:d},CL_ID,CL_POINT,0)",
        "ELSE",
        "CL_REASON=CL_WHY",
        "CL_ABORTED=CL_ID",
        "CL_RUNNING=0",
        f"CL_SAY({Event.ABORTED:d},CL_ID,CL_POINT,CL_REASON)",
        "ENDIF",
        "CL_BRAKE=FALSE",
        "CL_HAVE=0",
        "CL_WANT=0",
        "CL_DRAIN()",
        "END",
        "",
        "DEF CL_MOVE_ALL ( )",
        "; interrupts are on in here only, one level below their declaration",
        "DECL INT I,K,PERCENT",
        *_interrupts("ON"),
        "FOR I=1 TO CL_WANT",
        f"IF CL_BRAKE OR CL_STOPPED OR $TIMER_FLAG[{timer}] OR (CL_MY_BOOT<>CL_BOOT) THEN",
        *_interrupts("OFF"),
        "IF CL_STOPPED THEN",
        "; a stop that came between the acceptance and the first point",
        f"CL_WHY={Reason.STOPPED:d}",
        "ENDIF",
        f"IF $TIMER_FLAG[{timer}] THEN",
        f"CL_WHY={Reason.WATCHDOG:d}",
        "ENDIF",
        "RETURN",
        "ENDIF",
        "; whole percents, rounded down: never faster than asked, but 1 at the least",
        "PERCENT=CL_SPEED[I]",
        "IF PERCENT>CL_SPEED[I] THEN",
        "PERCENT=PERCENT-1",
        "ENDIF",
        "IF PERCENT<1 THEN",
        "PERCENT=1",
        "ENDIF",
        f"FOR K=1 TO {AXES}",
        "$VEL_AXIS[K]=PERCENT",
        "ENDFOR",
        "PTP CL_TARGET[I]",
        "WAIT SEC 0",
        "CL_POINT=I",
        f"CL_SAY({Event.POINT:d},CL_ID,I,0)",
        "ENDFOR",
        *_interrupts("OFF"),
        "WAIT SEC 0",
        "END",
        "",
        "DEF CL_HALT ( )",
        "BRAKE",
        *_interrupts("OFF"),
        "RESUME",
        "END",
        "",
        "DEF CL_STARVED ( )",
        "BRAKE",
        *_interrupts("OFF"),
        f"CL_WHY={Reason.WATCHDOG:d}",
        "RESUME",
        "END",
        "",
        "DEF CL_TAKE ( )",
        "; one document: kept if it is the next point of one program, else the program is refused once",
        "CL_READ()",
        "IF CL_GOT_POINT==1 THEN",
        "CL_BAD=0",
        "CL_ID=CL_GOT_ID",
        "CL_HAVE=0",
        "CL_WANT=CL_GOT_COUNT",
        "ENDIF",
        "IF CL_GOT_ID==CL_BAD THEN",
        "RETURN",
        "ENDIF",
        "IF CL_GOT_BOOT<>CL_BOOT THEN",
        "CL_ID=CL_GOT_ID",
        f"CL_REFUSE({Reason.WRONG_BOOT:d})",
        "RETURN",
        "ENDIF",
        "IF CL_GOT_ID<=CL_ACCEPTED THEN",
        "CL_ID=CL_GOT_ID",
        f"CL_REFUSE({Reason.ID_NOT_NEW:d})",
        "RETURN",
        "ENDIF",
        "IF (CL_GOT_ID<>CL_ID) OR (CL_GOT_COUNT<>CL_WANT) OR (CL_GOT_POINT<>CL_HAVE+1) OR (CL_GOT_POINT>CL_WANT)"
        f" OR (CL_WANT>{LONGEST_PROGRAM}) THEN",
        "CL_ID=CL_GOT_ID",
        f"CL_REFUSE({Reason.POINTS:d})",
        "RETURN",
        "ENDIF",
        "IF (CL_GOT_SPEED<=0.0) OR (CL_GOT_SPEED>100.0) THEN",
        f"CL_REFUSE({Reason.SPEED:d})",
        "RETURN",
        "ENDIF",
        *_limits(),
        "CL_HAVE=CL_GOT_POINT",
        "CL_TARGET[CL_HAVE]=CL_GOT",
        "CL_SPEED[CL_HAVE]=CL_GOT_SPEED",
        "END",
        "",
        "DEF CL_READ ( )",
        "DECL EKI_STATUS RET",
        *(_got(element) for element in MOTION.receive),
        "END",
        "",
        "DEF CL_DRAIN ( )",
        "; what came while the robot moved is refused, not executed afterwards",
        "DECL EKI_STATUS RET",
        f'RET=EKI_CheckBuffer("{MOTION.name}","{LAST}")',
        "WHILE RET.Buff>0",
        "CL_READ()",
        "IF CL_GOT_ID<>CL_BAD THEN",
        "CL_ID=CL_GOT_ID",
        f"CL_REFUSE({Reason.RUNNING:d})",
        "ENDIF",
        f'RET=EKI_CheckBuffer("{MOTION.name}","{LAST}")',
        "ENDWHILE",
        "END",
        "",
        "DEF CL_REFUSE (WHY:IN )",
        "DECL INT WHY",
        "CL_BAD=CL_ID",
        "CL_HAVE=0",
        "CL_WANT=0",
        "CL_REASON=WHY",
        f"CL_SAY({Event.REFUSED:d},CL_ID,0,WHY)",
        "END",
        "",
        "DEF CL_REOPEN ( )",
        "DECL EKI_STATUS RET",
        *reopened(MOTION.name),
        "END",
        "",
        "DEF CL_DISCARD ( )",
        "CL_HAVE=0",
        "CL_WANT=0",
        "CL_ID=0",
        "CL_BAD=0",
        "END",
        "",
        "DEFFCT INT CL_MAY_MOVE ( )",
        "IF CL_STOPPED THEN",
        f"RETURN {Reason.STOPPED:d}",
        "ENDIF",
        "IF $ALARM_STOP==FALSE THEN",
        f"RETURN {Reason.EMERGENCY_STOP:d}",
        "ENDIF",
        "IF ($MODE_OP<>#EX) AND ($MODE_OP<>#AUT) THEN",
        f"RETURN {Reason.MODE:d}",
        "ENDIF",
        "IF $PERI_RDY==FALSE THEN",
        f"RETURN {Reason.DRIVES_OFF:d}",
        "ENDIF",
        "RETURN 0",
        "ENDFCT",
        "",
        "DEF CL_SAY (WHAT:IN,NUMBER:IN,PT:IN,WHY:IN )",
        "DECL INT WHAT,NUMBER,PT,WHY",
        "DECL EKI_STATUS RET",
        f"IF $FLAG[{alive}] THEN",
        *(
            f'RET=EKI_SetInt("{MOTION.name}","{element.tag}",{value})'
            for element, value in zip(MOTION.send, ("CL_MY_BOOT", "WHAT", "NUMBER", "PT", "WHY"), strict=True)
        ),
        f'RET=EKI_Send("{MOTION.name}","{MOTION.send[0].root}")',
        "ENDIF",
        "END",
    ]
    return _text(lines)


def reopened(channel: str) -> list[str]:
    """The lines that open a channel, or open it again once its client is gone."""
    return [f'RET=EKI_{verb}("{channel}")' for verb in ("Clear", "Init", "Open")]


def _interrupts(switch: str) -> list[str]:
    return [f"INTERRUPT {switch} {k}" for k in (BRAKE_INTERRUPT, WATCHDOG_INTERRUPT, ALIVE_INTERRUPT)]


def _limits() -> Iterator[str]:
    for k in range(1, AXES + 1):
        axis = f"CL_GOT.A{k}"
        outside = f"({axis}<CL_MIN[{k}]) OR ({axis}>CL_MAX[{k}])"
        yield f"IF {outside} OR ({axis}<$SOFTN_END[{k}]) OR ({axis}>$SOFTP_END[{k}]) THEN"
        yield f"CL_REFUSE({Reason.AXIS_LIMIT:d})"
        yield "RETURN"
        yield "ENDIF"


def _got(element: Element) -> str:
    """The line that takes one value out of its buffer."""
    last = element.tag.rpartition("/")[2]
    into = f"CL_GOT.{last[1:]}" if last.startswith("@") else f"CL_GOT_{last.upper()}"
    verb = {"INT": "GetInt", "REAL": "GetReal", "BOOL": "GetBool"}[element.type]
    return f'RET=EKI_{verb}("{MOTION.name}","{element.tag}",{into})'


def _text(lines: Sequence[str]) -> str:
    """KRL in the line ends of the controller."""
    return "\r\n".join(lines) + "\r\n"
