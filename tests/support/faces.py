"""What each room offers: the lists that the faces (`__init__.__all__`) are held to."""

FACES = {
    name: text.split()
    for name, text in {
        "dehyst": """
            Actuator Bank ClampWarning Columns Compensator DehystError DisplacementCreep
            Dynamics Feedback FileFormatError Fit IdentifyError MaxwellSlip ModelError
            PathPlan Record RecordError Repetition RigError
            Spring Stage
            StageCompensator State Structure Thermal VoltageLimits __version__ calibrate
            check compare export identify insight plan_path read update
            wave_table write_record
        """,
        "calibration": """
            Calibration Plan TrackedPath calibrate
        """,
        "cli": """
            main
        """,
        "control": """
            Bank ClampWarning Compensator Feedback Homing PathPlan PossibleStart Repetition
            SensorFault SensorWarning StageCompensator StartError VoltageLimits WaveTable
            model_block plan_path shortest_homing wave_table
        """,
        "exports": """
            SourceOnlyWarning export wasm_module
        """,
        "fleet": """
            FleetTable identify_fleet
        """,
        "identification": """
            Check Deadline Fit Outcome RecordErrors StageFit Structure Trace Verdict identify
            initial_state state_after
        """,
        "instruments": """
            AbstractRig DeviceError LinkError Reading RigError Samples SensorError open_rig
        """,
        "model": """
            AbstractModel Actuator DisplacementCreep Dynamics GradedSlip Identification MaxwellSlip Motion
            Physical Promise SmoothSlip Spring Stage State Thermal Transformer promised simulated
        """,
        "records": """
            Columns Record read write_record
        """,
        "report": """
            write_comparison write_insight write_record_page write_report
        """,
        "paper": """
            Paper PaperFit identify
        """,
        "testing": """
            FakeInstrument RigCandidate RigContract
        """,
        "trust": """
            AbstractBaseline Change Insight ModelComparison Recheck Update check
            compare insight update
        """,
        "virtual": """
            PlayActuator VirtualBench VirtualStage
        """,
        "waveforms": """
            Excitation Raster Sampling Scan ScanPath Steps
            Triangle descending_tops homing raised_cosine recommended stage_excitation staircase
        """,
        "web": "",
        "workbench": """
            serve
        """,
    }.items()
}
# Drivers are imported one by one: each needs a library or an instrument of its own.
DRIVERS = {
    "dehyst.instruments.epics": ["EpicsRig", "PvNames"],
    "dehyst.instruments.pi": ["PiRig"],
}
