"""Stages: several coupled axes, y = C h(v): their records, identification, simulation and compensation."""

from dehyst.stages.assessment import StageInsight, StageRecheck, check_stage, stage_insight
from dehyst.stages.calibration.experiment import StageCalibration, StagePlan, calibrate_stage
from dehyst.stages.compensator import StageCompensator
from dehyst.stages.excitation import StageExcitation, stage_excitation
from dehyst.stages.firmware import ExportedStage, export_stage
from dehyst.stages.fit import StageFit
from dehyst.stages.homing import HomedStage, home_stage_before
from dehyst.stages.identify import identify_stage
from dehyst.stages.page import write_stage_report
from dehyst.stages.read import read_stage
from dehyst.stages.record import StageRecord
from dehyst.stages.stage import Stage
from dehyst.stages.stage_trace import StageTrace

__all__ = [
    "ExportedStage",
    "HomedStage",
    "Stage",
    "StageCalibration",
    "StageCompensator",
    "StageExcitation",
    "StageFit",
    "StageInsight",
    "StagePlan",
    "StageRecheck",
    "StageRecord",
    "StageTrace",
    "calibrate_stage",
    "check_stage",
    "export_stage",
    "home_stage_before",
    "identify_stage",
    "read_stage",
    "stage_excitation",
    "stage_insight",
    "write_stage_report",
]
