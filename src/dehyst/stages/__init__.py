"""Stages: several coupled axes, y = C h(v): their records, identification, simulation and compensation."""

from dehyst.stages.assessment import StageInsight, StageRecheck, check_stage, stage_insight
from dehyst.stages.compensator import StageCompensator
from dehyst.stages.excitation import stage_excitation
from dehyst.stages.homing import home_stage_before, plan_stage_path, plan_stage_voltage
from dehyst.stages.identify import StageFit, identify_stage
from dehyst.stages.stage import Stage, StageTrace

__all__ = [
    "Stage",
    "StageCompensator",
    "StageFit",
    "StageInsight",
    "StageRecheck",
    "StageTrace",
    "check_stage",
    "home_stage_before",
    "identify_stage",
    "plan_stage_path",
    "plan_stage_voltage",
    "stage_excitation",
    "stage_insight",
]
