"""Which check catches which planted fault: the proof of the validators."""

import numpy as np
import pytest

from sdfrender import optics
from validate.battery import CHECKS, NO_NUMBER, Check, Ground, Subject, measured
from validate.experiment import Run
from validate.faults import FAULTS, planted
from validate.sections import faults as said
from validate.suites.faults import HEALTHY, battery

BEAMS = {"closed-form mirror", "closed-form glass"}
DISPLACED = {"displaced at mirrors", "displaced at glass"}
FORMS = {"form at mirrors", "form at glass"}
# Exactly these fire; all others are blind.
CAUGHT = {
    HEALTHY: set(),
    # Displaced rays bend as wrongly as the beam; a mirror has no index.
    "wrong eta": {"form at glass", "closed-form glass"},
    "no dt/dx": BEAMS | DISPLACED | FORMS | {"unit and tangent", "order"},
    # A distance's gradient is nearly 1 long: the closed forms' limits and the order do not see the difference.
    "normal not normalised": DISPLACED | FORMS | {"unit and tangent", "twice the distance"},
    # Another surface's curvature is as symplectic.
    "curvature times three": BEAMS | DISPLACED | {"order"},
    "layer swapped": {"uv", "chart"},
    # The surface is elsewhere, and consistent in itself.
    "half a voxel off": BEAMS | {"order", "hit", "uv", "chart"},
}


@pytest.fixture(scope="module")
def ground():
    return Ground.made()


@pytest.fixture(scope="module")
def runs(ground):
    """The battery with each fault."""
    return {HEALTHY if fault is None else fault.name: battery(fault, ground) for fault in (None, *FAULTS)}


def test_every_check_is_tried_with_every_fault(runs):
    assert set(runs) == set(CAUGHT) and len(FAULTS) == 6
    for found in runs.values():
        assert [run.setup["check"] for run in found] == [check.name for check in CHECKS]
        assert all(run.ok and np.isfinite(run.values["figure"]) for run in found)


@pytest.mark.parametrize("fault", CAUGHT)
def test_which_checks_catch_it(fault, runs):
    assert set(said.caught(runs[fault])) == CAUGHT[fault]


def test_no_check_is_useless_and_none_is_near_its_limit(runs):
    """Each catches a fault; what passes has half of its limit left, and what is caught is a third beyond it."""
    assert set.union(*CAUGHT.values()) == {check.name for check in CHECKS}
    for found in runs.values():
        for run in found:
            share = run.values["figure"] / run.values["limit"]
            assert share < 0.5 or share > 1.3, (run.problem, run.setup["check"], share)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_is_taken_back(fault):
    right = getattr(fault.owner, fault.attribute)
    with pytest.raises(ZeroDivisionError), planted(fault):
        assert getattr(fault.owner, fault.attribute) is not right
        raise ZeroDivisionError
    assert getattr(fault.owner, fault.attribute) is right


def test_no_fault_changes_nothing():
    right = optics.refract
    with planted(None):
        assert optics.refract is right


@pytest.mark.parametrize("figure", [np.nan, np.inf, 1e12])
def test_no_number_is_the_worst_figure(figure):
    check = Check("c", "nothing", 1.0, "", lambda subject: figure)
    assert measured(check, object.__new__(Subject)) == NO_NUMBER  # it is not looked at


def test_findings_follow_the_numbers(runs):
    every = [run for found in runs.values() for run in found]
    good = said.section(every)
    assert good.finding[0] == f"The healthy renderer passes all {len(CHECKS)} checks."
    assert good.finding[1] == "Of 6 planted faults 6 are caught."
    assert good.headlines[0].figure == "6 of 6 / 0" and good.headlines[0].met is True
    assert "wrong eta: caught by form at glass, closed-form glass; 10 checks are blind to it." in good.finding

    blind = [run for run in every if run.problem != "layer swapped" or run.setup["check"] not in ("uv", "chart")]
    alarm = Run("faults", HEALTHY, runs[HEALTHY][0].setup, {}, "error", {"figure": 2.0, "limit": 1.0, "caught": 1.0})
    bad = said.section([alarm, *blind[1:]])
    assert bad.finding[0].startswith(f"The healthy renderer fails 1 of {len(CHECKS)} checks: form at mirrors")
    assert bad.finding[1] == "Of 6 planted faults 5 are caught; nothing finds layer swapped."
    assert bad.headlines[0].figure == "5 of 6 / 1" and bad.headlines[0].met is False
    assert said.section([]).finding == ("No run succeeded, so no check was tried.",)
