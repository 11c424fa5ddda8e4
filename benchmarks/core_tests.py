"""Which tests are to see a fault in which file of the core, for `mutants.py`."""

_FEW = ["tests/accuracy/test_scan.py", "tests/accuracy/test_redundant_zone.py", "tests/accuracy/test_zone.py"]
_COUNTERS = [
    "tests/trajectory/test_counter_faults.py",
    "tests/trajectory/test_redundant_faults.py",
    "tests/test_docs.py::test_constants_are_those_of_the_program",
]
_SEALED = [
    "tests/certification/test_iso_tests.py",
    "tests/certification/test_paths.py",
    "tests/certification/test_corners_and_weaves.py",
    "tests/certification/test_method.py",
    "tests/certification/test_evaluation.py",
    "tests/certification/test_instants.py",
    "-k",
    "method_3 or test_evaluation or test_instants or test_iso_tests or corners_cut or at_its_corner or of_a_stroke",
]
_CHANNELS = [
    "tests/observation/test_kinds.py",
    "tests/observation/test_parameters.py",
    "tests/observation/test_solver.py",
    "tests/observation/test_encoders.py",
    "tests/observation/test_runs_of_sensors.py",
]
_OF_ESTIMATION = "release gauge least_squares judging robust_loss groups_left_out rival_explanations"
_ESTIMATED = [f"tests/estimation/test_{name}.py" for name in _OF_ESTIMATION.split()]
_STRAIGHT = ["tests/lcoordinate/test_straight.py", "-k", "not forty and not monodromy"]
_LIMITS = ["tests/lcoordinate/test_limits_in_closed_form.py", "tests/lcoordinate/test_workspace.py"]
_KINDS = "cable channel continuation distance inclination joint of_rig parameters solver swivel wrap"
_TESTS = "pose approaches exchangeability drift distance compliance path velocity corners weaving settling posing stabilisation"
_EVALUATED = "angles attainment capability evaluate exclusions figure fitted_frame instants"
_CAMPAIGNS = [
    "tests/calibration/test_laws_of_residuals.py",
    "tests/calibration/test_laws_of_covariance.py",
    "tests/calibration/test_recover.py",
    "tests/calibration/test_visits.py",
    "tests/calibration/test_with_encoders.py",
    "-k",
    "(laws_of or exact_poses or stated_pose or default or visit or two_passes or derivatives_are) and not order_of_counting",
]
_RESIDUALS = [*(name for name in _CAMPAIGNS[:-2] if "laws_of" in name or "encoders" in name), "-k", "laws_of or derivatives_are"]
CORE = {
    **{f"kernels/{name}.py": [*_FEW, "-k", "few or generalised or zero_pose or definitions"] for name in ("zone", "zone_rows")},
    **{f"kernels/{name}.py": [*_FEW[:2], "-k", "few"] for name in ("zone_lanes", "zone_linked", "zone_six", "zone_redundant")},
    "kernels/cable.py": ["tests/kernels/test_cable.py", "-k", "not on_its_axis"],
    "kernels/counter.py": ["tests/kernels/test_counter.py", "tests/acquisition/test_counters.py"],
    "kernels/screw.py": ["tests/kernels/test_screw.py"],
    "kernels/lanes.py": ["tests/kernels/test_lanes.py", "-k", "few_samples or 75_degrees_in"],
    **{
        f"kernels/{name}.py": [
            "tests/kernels/test_followed_channels.py",
            "tests/observation/test_fast_paths.py",
            "-k",
            "test_followed_channels or few_samples",
        ]
        for name in ("least_squares", "damped")
    },
    "lcoordinate/singularity.py": ["tests/lcoordinate/test_singularity.py", "tests/lcoordinate/test_around_singular_poses.py"],
    "lcoordinate/architecture.py": ["tests/lcoordinate/test_architecture.py", "tests/lcoordinate/test_proofs.py"],
    "lcoordinate/certified.py": ["tests/lcoordinate/test_proofs.py", *_STRAIGHT],
    "lcoordinate/levers.py": ["tests/lcoordinate/test_levers.py"],
    "lcoordinate/pluecker.py": ["tests/lcoordinate/test_links.py", "tests/lcoordinate/test_singularity.py"],
    "lcoordinate/singular.py": ["tests/lcoordinate/test_links.py"],
    "lcoordinate/starts.py": ["tests/lcoordinate/test_start_systems.py", *_STRAIGHT],
    "lcoordinate/straight.py": ["tests/lcoordinate/test_start_systems.py", *_STRAIGHT],
    "lcoordinate/structures.py": [
        f"tests/lcoordinate/test_{name}.py" for name in ("structures", "proofs", "start_systems", "architecture")
    ],
    "lcoordinate/study.py": _STRAIGHT,
    "lcoordinate/tetrahedra.py": ["tests/lcoordinate/test_start_systems.py", *_STRAIGHT],
    "lcoordinate/workspace.py": [*_LIMITS, "-k", "closed_form or lines_between or without_a_slope"],
    "lcoordinate/intervals.py": ["tests/lcoordinate/test_flat.py"],
    "lcoordinate/flat.py": ["tests/lcoordinate/test_flat.py"],
    "lcoordinate/bounds.py": ["tests/lcoordinate/test_bounds.py", "tests/lcoordinate/test_workspace.py", "-k", "test_bounds or in_several"],
    "lcoordinate/detour.py": [*_LIMITS, "-k", "closed_form or least_step or limit_angle_keeps"],
    "estimation/least_squares.py": _ESTIMATED,
    "estimation/fit.py": _ESTIMATED,
    "estimation/elimination.py": _ESTIMATED,
    "estimation/regions.py": [*_ESTIMATED, "tests/estimation/test_laws_of_regions.py", "tests/calibration/test_regions.py"],
    "estimation/deletion.py": _ESTIMATED,
    "estimation/robust.py": _ESTIMATED,
    "estimation/explanations.py": _ESTIMATED,
    "estimation/problem.py": _ESTIMATED,
    "estimation/exchange.py": ["tests/estimation/test_exchange.py"],
    "estimation/information.py": ["tests/estimation/test_exchange.py"],
    "estimation/observability.py": ["tests/estimation/test_observability.py"],
    "estimation/normal_equations.py": ["tests/estimation/test_normal_equations.py"],
    **{f"observation/{name}.py": _CHANNELS for name in _KINDS.split()},
    "observation/parameters.py": ["tests/observation/test_parameters.py"],
    "observation/parts.py": ["tests/observation/test_parts.py", "tests/observation/test_parts_of_unlike_cables.py"],
    "observation/cable_effects.py": ["tests/observation/test_parts.py", "tests/test_unsolved.py", "tests/test_taken_as_exact.py"],
    "calibration/residuals.py": _RESIDUALS,
    "calibration/unknowns.py": _CAMPAIGNS,
    "calibration/misfit.py": [
        "tests/calibration/test_doubted_residuals.py",
        "tests/calibration/test_with_encoders.py",
        "tests/calibration/test_real_world.py",
        "-k",
        "doubted or errs_is_named or sound_data or positions or state_nothing or run-out or that_was_named",
    ],
    "trajectory/budget.py": ["tests/trajectory/test_sources_of_error.py", "tests/trajectory/test_budget.py"],
    "trajectory/second_order.py": ["tests/trajectory/test_second_order.py", "-k", "not lie_in_their_regions"],
    "trajectory/exact.py": ["tests/test_taken_as_exact.py"],
    "trajectory/steps.py": ["tests/trajectory/test_steps.py", *_COUNTERS],
    "trajectory/continuity.py": [
        *(f"tests/trajectory/test_continuity{which}.py" for which in ("_definition", "_limits", "")),
        *_COUNTERS,
    ],
    "trajectory/standing.py": ["tests/trajectory/test_standing.py", *_COUNTERS],
    "trajectory/doubts.py": ["tests/trajectory/test_doubts.py", *_COUNTERS],
    "trajectory/redundancy.py": ["tests/trajectory/test_redundancy.py", *_COUNTERS],
    "trajectory/spans.py": ["tests/trajectory/test_spans.py"],
    "trajectory/consistency.py": ["tests/trajectory/test_consistency.py"],
    "interpolation.py": ["tests/test_interpolation.py", "tests/trajectory/test_passes.py", "-k", "interpolation or between"],
    "certification/iso9283_pose.py": ["tests/certification/test_iso9283.py"],
    "certification/iso9283_path.py": ["tests/certification/test_iso9283.py"],
    "certification/iso9283_time.py": ["tests/certification/test_iso9283.py"],
    "certification/uncertainty.py": [
        "tests/certification/test_u95.py",
        "tests/certification/test_instants.py",
        "tests/certification/test_method.py",
        "-k",
        "test_u95 or test_instants",
    ],
    "certification/verify.py": ["tests/certification/test_verify.py"],
    "certification/again.py": ["tests/certification/test_verify.py"],
    **{f"certification/iso9283/{name}.py": _SEALED for name in _TESTS.split()},
    **{f"certification/{name}.py": _SEALED for name in _EVALUATED.split()},
    "certification/attainment.py": ["tests/certification/test_attainment.py", *_SEALED[:-1], f"test_attainment or {_SEALED[-1]}"],
    "certification/iso9283/pose.py": [
        "tests/certification/test_pose_laws.py",
        "tests/certification/test_u95.py",
        *_SEALED[:-1],
        f"test_pose_laws or stays_so or {_SEALED[-1]}",
    ],
    "certification/iso9283/path.py": ["tests/certification/test_path_laws.py", *_SEALED[:-1], f"test_path_laws or {_SEALED[-1]}"],
    "certification/evaluate.py": ["tests/certification/test_u95.py", *_SEALED[:-1], f"what_is_done or have_none or {_SEALED[-1]}"],
    "certification/exclusions.py": ["tests/certification/test_exclusions.py"],
    "certification/fitted_frame.py": ["tests/certification/test_fitted_frame.py"],
    "certification/capability.py": ["tests/certification/test_capability_limits.py"],
    "certification/angles.py": ["tests/certification/test_angles.py", *_SEALED[:-1], f"test_angles or {_SEALED[-1]}"],
    "certification/iso9283/corners.py": ["tests/certification/test_corner_laws.py", *_SEALED[:-1], f"test_corner_laws or {_SEALED[-1]}"],
    "certification/iso9283/weaving.py": ["tests/certification/test_weave_laws.py", *_SEALED[:-1], f"test_weave_laws or {_SEALED[-1]}"],
    "counts.py": ["tests/test_counts.py", "tests/test_counts_at_rest.py"],
    "findings.py": ["tests/test_findings.py"],
    "trajectory/pose_errors.py": [
        "tests/trajectory/test_pose_errors.py",
        "tests/certification/test_u95.py",
        "tests/certification/test_method.py",
        "-k",
        "test_pose_errors or in_common or method_3",
    ],
    "acquisition/samples.py": ["tests/acquisition/test_samples.py", "tests/acquisition/test_faults_of_samples.py"],
    "accuracy/zone.py": [
        "tests/accuracy/test_parts_of_a_zone.py",
        "tests/accuracy/test_zone_of_channels.py",
        "tests/accuracy/test_zone.py",
        "-k",
        "not 60_degrees and not limit_of and not volume and not limits_asked and not assembly_is",
    ],
}
"""Files of the package, and the tests that are to see a fault in them; those of kernels are short without compiling."""
