"""The space that the envelope sweeps encloses every pose's envelope; the certificate's words say its figures."""

from __future__ import annotations

import igl
import numpy as np

from ctrplan.plans.plan import Plan
from ctrplan.reports.plan_scene import plan_scene
from ctrplan.reports.plan_words import certificate_in_words
from ctrplan.reports.robot_surface import _depths, _grid, swept_surface
from ctrplan.reports.words import millimetres


def test_swept_space_holds_every_envelope_and_little_more(plan: Plan) -> None:
    path = plan_scene(plan, 6).path
    surface = swept_surface(path)
    centres = np.concatenate([step.envelope.centreline_m for step in path])
    radii = np.concatenate([step.envelope.radius_m for step in path])
    winding = np.abs(igl.fast_winding_number(surface.vertices_m, surface.faces, centres[radii > 0]))
    assert np.all(winding > 0.5)
    apart = np.linalg.norm(surface.vertices_m[:, None] - centres, axis=2) - radii
    assert apart.min(axis=1).max() < 2.5e-3 and apart.min(axis=1).min() > -2e-3  # the union's surface, within a cell


def test_thin_rods_are_not_beads_on_a_string(plan: Plan) -> None:
    """Between two stations of the centreline the body is within the space as well."""
    path = plan_scene(plan, 2).path
    surface = swept_surface(path)
    for pose in path:
        line = pose.envelope.centreline_m
        between = np.concatenate([line[:-1] + share * np.diff(line, axis=0) for share in (0.25, 0.5, 0.75)])
        assert np.all(igl.winding_number(surface.vertices_m, surface.faces, between) > 0.5)


def test_depths_are_those_of_every_sphere_asked_one_by_one() -> None:
    """Also where a small sphere is nearer to a node than the large one whose surface is nearest."""
    rng = np.random.default_rng(0)
    cell = 1e-3
    nodes, counts = _grid(np.full(3, -0.02), np.full(3, 0.021), cell)
    centres, radii = rng.uniform(-0.008, 0.008, (12, 3)), rng.choice([1e-3, 2e-3, 8e-3], 12)
    found = _depths(nodes, counts, centres, radii, cell)
    apart = (np.linalg.norm(nodes[:, None] - centres, axis=2) - radii).min(axis=1)
    assert np.all((found < 0) == (apart < 0))
    single = _depths(nodes, counts, centres[:1], radii[:1], cell)
    near = np.abs(single) < 2 * cell
    np.testing.assert_allclose(single[near], (np.linalg.norm(nodes - centres[0], axis=1) - radii[0])[near], atol=1e-12)


def test_words_say_the_figures(plan: Plan) -> None:
    text = " ".join(certificate_in_words(plan))
    certificate = plan.certificate
    for length_m in (certificate.worst_bound_m, certificate.goal_bound_m, certificate.min_clearance_m):
        assert millimetres(abs(length_m)) in text
    assert f"{len(certificate.samples.leg)} places" in text and "in all 4 combinations" in text
