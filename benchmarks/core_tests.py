"""Which tests are to see a fault in which file of the core, for `mutants.py`."""

_FEW = ["tests/accuracy/test_scan.py", "tests/accuracy/test_redundant_zone.py", "tests/accuracy/test_zone.py"]
_COUNTERS = [
    "tests/trajectory/test_counter_faults.py",
    "tests/trajectory/test_redundant_faults.py",
    "tests/documents/test_docs.py::test_constants_are_those_of_the_program",
]
_SEALED = [
    "tests/iso9283/test_iso_tests.py",
    "tests/iso9283/test_paths.py",
    "tests/iso9283/test_corners_and_weaves.py",
    "tests/certificate/test_method.py",
    "tests/iso9283/test_evaluation.py",
    "tests/iso9283/test_instants.py",
    "-k",
    "method_3 or test_evaluation or test_instants or test_iso_tests or corners_cut or at_its_corner or of_a_stroke",
]
_CHANNELS = ["tests/sensors/test_kinds.py", "tests/sensors/test_parameters.py", "tests/sensors/test_encoders.py"]
_OF_ESTIMATION = "release gauge least_squares judging robust_loss groups_left_out rival_explanations"
_ESTIMATED = [f"tests/estimation/test_{name}.py" for name in _OF_ESTIMATION.split()]
_STRAIGHT = ["tests/linkages/test_straight.py", "-k", "not forty and not monodromy"]
_LIMITS = ["tests/linkages/test_limits_in_closed_form.py", "tests/linkages/test_workspace.py"]
_TESTS = "pose cycle_groups distance compliance path velocity corners weaving settling stabilisation"
_EVALUATED = "attainment evaluation figure"
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
    **{f"kernels/{name}.py": [*_FEW[:2], "-k", "few"] for name in ("zone_lanes", "zone_linked", "zone_redundant")},
    "kernels/cable.py": ["tests/kernels/test_cable.py", "-k", "not on_its_axis"],
    "kernels/counter.py": ["tests/kernels/test_counter.py", "tests/acquisition/test_counters.py"],
    "kernels/screw.py": ["tests/kernels/test_screw.py"],
    "kernels/lanes.py": ["tests/kernels/test_lanes.py", "-k", "few_samples or 75_degrees_in"],
    "kernels/least_squares.py": [
        "tests/kernels/test_followed_channels.py",
        "tests/sensors/test_fast_paths.py",
        "-k",
        "test_followed_channels or few_samples",
    ],
    "linkages/singularity.py": [
        f"tests/linkages/test_{name}.py" for name in ("singularity", "around_singular_poses", "links", "architecture", "proofs")
    ],
    "linkages/krawczyk.py": ["tests/linkages/test_proofs.py", *_STRAIGHT],
    "linkages/rods.py": ["tests/linkages/test_rods.py"],
    "linkages/start_systems.py": ["tests/linkages/test_start_systems.py", *_STRAIGHT],
    "linkages/straight_links.py": ["tests/linkages/test_start_systems.py", *_STRAIGHT],
    "linkages/topology.py": [
        f"tests/linkages/test_{name}.py" for name in ("structures", "proofs", "start_systems", "architecture", "variants")
    ],
    "linkages/study_quadric.py": _STRAIGHT,
    "linkages/tetrahedra.py": ["tests/linkages/test_start_systems.py", *_STRAIGHT],
    "linkages/workspace.py": [*_LIMITS, "-k", "closed_form or lines_between or without_a_slope"],
    "linkages/intervals.py": ["tests/linkages/test_flat.py"],
    "linkages/flat_tetrahedra.py": ["tests/linkages/test_flat.py"],
    "linkages/bounds.py": ["tests/linkages/test_bounds.py", "tests/linkages/test_workspace.py", "-k", "test_bounds or in_several"],
    "linkages/detours.py": [*_LIMITS, "-k", "closed_form or limit_angle_keeps"],
    "estimation/least_squares.py": _ESTIMATED,
    "estimation/elimination.py": _ESTIMATED,
    "estimation/confidence_regions.py": [*_ESTIMATED, "tests/estimation/test_laws_of_regions.py", "tests/calibration/test_regions.py"],
    "estimation/deletion.py": _ESTIMATED,
    "estimation/robust.py": _ESTIMATED,
    "estimation/explanations.py": _ESTIMATED,
    "estimation/problem.py": _ESTIMATED,
    "estimation/exchange.py": ["tests/estimation/test_exchange.py"],
    "estimation/observability.py": ["tests/estimation/test_exchange.py", "tests/estimation/test_observability.py"],
    "estimation/normal_equations.py": ["tests/estimation/test_normal_equations.py"],
    "sensors/channels.py": [*_CHANNELS, "tests/sensors/test_fast_paths.py"],
    "sensors/wrap.py": _CHANNELS,
    "rig/parameters.py": ["tests/sensors/test_parameters.py"],
    "sensors/imperfect_parts.py": [
        *(f"tests/sensors/test_{name}.py" for name in ("parts", "parts_of_unlike_cables", "unsolved")),
        "tests/trajectory/test_assumed.py",
    ],
    "calibration/solve/residuals.py": _RESIDUALS,
    "calibration/solve/unknowns.py": _CAMPAIGNS,
    "calibration/validation/misfit.py": [
        "tests/calibration/test_doubted_residuals.py",
        "tests/calibration/test_with_encoders.py",
        "tests/calibration/test_real_world.py",
        "-k",
        "doubted or errs_is_named or sound_data or positions or state_nothing or run-out or that_was_named",
    ],
    "trajectory/uncertainty/budget.py": [f"tests/trajectory/test_{name}.py" for name in ("sources_of_error", "budget", "assumed")],
    "trajectory/uncertainty/sources.py": [
        "tests/trajectory/test_second_order.py",
        "tests/trajectory/test_sources_of_error.py",
        "-k",
        "not lie_in_their_regions",
    ],
    "trajectory/faults/continuity.py": [
        *(f"tests/trajectory/test_{name}.py" for name in ("continuity_definition", "continuity_limits", "steps", "standing", "doubts")),
        *_COUNTERS,
    ],
    "trajectory/faults/rest_evidence.py": ["tests/trajectory/test_doubts.py", "tests/trajectory/test_evidence.py", *_COUNTERS],
    "trajectory/faults/redundancy.py": ["tests/trajectory/test_redundancy.py", *_COUNTERS],
    "trajectory/faults/consistency.py": ["tests/trajectory/test_spans.py", "tests/trajectory/test_consistency.py"],
    "core/interpolation.py": ["tests/core/test_interpolation.py", "tests/trajectory/test_passes.py", "-k", "interpolation or between"],
    "iso9283/formulas.py": ["tests/iso9283/test_iso9283.py"],
    "iso9283/uncertainty.py": [
        "tests/iso9283/test_u95.py",
        "tests/iso9283/test_instants.py",
        "tests/certificate/test_method.py",
        "-k",
        "test_u95 or test_instants",
    ],
    "certificate/verification.py": ["tests/certificate/test_verify.py"],
    **{f"iso9283/clauses/{name}.py": _SEALED for name in _TESTS.split()},
    **{f"iso9283/{name}.py": _SEALED for name in _EVALUATED.split()},
    "iso9283/attainment.py": [
        "tests/iso9283/test_attainment.py",
        "tests/iso9283/test_fitted_frame.py",
        *_SEALED[:-1],
        f"test_attainment or {_SEALED[-1]}",
    ],
    "iso9283/clauses/pose.py": [
        "tests/iso9283/test_pose_laws.py",
        "tests/iso9283/test_u95.py",
        *_SEALED[:-1],
        f"test_pose_laws or stays_so or {_SEALED[-1]}",
    ],
    "iso9283/clauses/path.py": ["tests/iso9283/test_path_laws.py", *_SEALED[:-1], f"test_path_laws or {_SEALED[-1]}"],
    "iso9283/evaluation.py": [
        "tests/iso9283/test_capability_limits.py",
        "tests/iso9283/test_u95.py",
        "tests/iso9283/test_exclusions.py",
        *_SEALED[:-1],
        f"test_exclusions or what_is_done or have_none or {_SEALED[-1]}",
    ],
    "iso9283/figure.py": ["tests/iso9283/test_angles.py", *_SEALED[:-1], f"test_angles or {_SEALED[-1]}"],
    "iso9283/clauses/corners.py": ["tests/iso9283/test_corner_laws.py", *_SEALED[:-1], f"test_corner_laws or {_SEALED[-1]}"],
    "iso9283/clauses/weaving.py": ["tests/iso9283/test_weave_laws.py", *_SEALED[:-1], f"test_weave_laws or {_SEALED[-1]}"],
    "recording/counts.py": ["tests/recording/test_counts.py", "tests/recording/test_counts_at_rest.py"],
    "text/messages.py": ["tests/text/test_findings.py"],
    "trajectory/uncertainty/pose_errors.py": [
        "tests/trajectory/test_pose_errors.py",
        "tests/iso9283/test_u95.py",
        "tests/certificate/test_method.py",
        "-k",
        "test_pose_errors or in_common",
    ],
    "acquisition/counters/samples.py": ["tests/acquisition/test_samples.py", "tests/acquisition/test_faults_of_samples.py"],
    "accuracy/zone.py": [
        "tests/accuracy/test_parts_of_a_zone.py",
        "tests/accuracy/test_zone_of_channels.py",
        "tests/accuracy/test_zone.py",
        "-k",
        "not 60_degrees and not limit_of and not volume and not limits_asked and not assembly_is",
    ],
}
"""Files of the package, and the tests that are to see a fault in them; those of kernels are short without compiling."""
