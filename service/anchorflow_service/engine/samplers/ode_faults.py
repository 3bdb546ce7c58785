"""What the manifest of an "ode" bundle has to say of its graphs."""

from __future__ import annotations

from collections.abc import Iterator

from anchorflow_service.bundle.manifest import Manifest, OdeEntry, SplineEntry
from anchorflow_service.engine.parts import missing_roles, unknown_names
from anchorflow_service.engine.samplers.flow_score import PRIOR_MEAN, answer_faults
from anchorflow_trajectory.scene import ROUTE_STATES

# What each role is fed besides the outputs of encode, and what it may ask for beside that where
# the prior is a mixture.
OWN_INPUTS = {"modulate": ("times",), "field": ("x_t", "modulation")}
OF_A_MIXTURE = {"modulate": (), "field": (PRIOR_MEAN,)}
OWN_OUTPUTS = {"modulate": ("modulation",), "field": ("dx_t",)}


def state_shape(manifest: Manifest) -> tuple[int, int]:
    """T and S of a flow's states, poses of D components first, as its field takes them."""
    graph = manifest.graphs["field"]
    steps, size = next(spec.shape[-2:] for spec in graph.inputs if spec.name == "x_t")
    return steps, size  # pyright: ignore[reportReturnType] - `faults` looks for letters


def has_mixture(manifest: Manifest) -> bool:
    """Whether the prior's means are several to a scene, and each anchor has its own."""
    assert isinstance(manifest.sampler, OdeEntry)
    prior = manifest.sampler.prior
    if prior is None or prior.mean == ROUTE_STATES:
        return prior is not None
    given = {spec.name: spec for spec in manifest.graphs["encode"].outputs}
    return prior.mean in given and len(given[prior.mean].shape) == 4


def ode_faults(manifest: Manifest) -> Iterator[str]:
    """Roles that are missing, and inputs that no other graph gives."""
    assert isinstance(manifest.sampler, OdeEntry)
    if missing := list(missing_roles(manifest, ("encode", *OWN_INPUTS))):
        yield from missing
        return
    context, prior = manifest.graphs["encode"].output_names, manifest.sampler.prior
    is_mixture = has_mixture(manifest)
    if prior is not None:
        yield from unknown_names("sampler.prior", (prior.basis,), context)
        yield from unknown_names("sampler.prior", (prior.mean,), (*context, ROUTE_STATES))
    for role, own in OWN_INPUTS.items():
        graph, where = manifest.graphs[role], f"graphs.{role}.inputs"
        known = (*own, *(OF_A_MIXTURE[role] if is_mixture else ()), *context)
        yield from unknown_names(where, graph.input_names, known)
        yield from unknown_names(where, own, graph.input_names)
        if graph.output_names != OWN_OUTPUTS[role]:
            names = ", ".join(graph.output_names)
            yield f"graphs.{role}.outputs: expected {OWN_OUTPUTS[role][0]}, got {names}"
    yield from answer_faults(manifest, context, mixture=is_mixture)
    steps, size = state_shape(manifest)
    finished = isinstance(manifest.finish, SplineEntry)
    least = 3 * manifest.D + 1 if finished else manifest.D
    if steps != manifest.time.steps or not isinstance(size, int) or size < least:
        own = f"{[steps, size]} for [T,S]"
        wanted = f"{manifest.time.steps} and at least {least} numbers"
        yield f"graphs.field.inputs: x_t has {own}, expected {wanted}"
