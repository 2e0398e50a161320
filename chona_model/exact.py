"""The paper's path, nothing cached and nothing skipped: the oracle that every faster path is measured against.

rays → conical frusta → canonical roots from K starts → conditional field at every distinct root → the densest root →
volume integration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor, nn

from chona_model.deform.between import look_between
from chona_model.deform.gradients import attach_implicit_gradients
from chona_model.deform.inverse import Roots, bone_distances, bone_starts, canonical_distances, find_roots
from chona_model.deform.predict import Prediction, predict
from chona_model.deform.regularisers import bone_regularisers
from chona_model.deform.skinning import ForwardSkinning
from chona_model.exact_shape import ExactShape
from chona_model.field.codes import IdentityCodes
from chona_model.field.radiance import FieldSample, RadianceField
from chona_model.figure import PoseBatch, RayBatch, RayResult, object_places, pose_code_size
from chona_model.geometry import inverse_3x3, safe_divide, safe_norm
from chona_model.render.bounds import BODY_REACH, OBJECT_MARGIN
from chona_model.render.frustum import conical_frusta, cylinders
from chona_model.render.integration import RayWeights, integrate, ray_weights, visible_confidence
from chona_model.render.rays import empty_result, finite, join, take_rays
from chona_model.render.sampling import stratified_edges
from chona_model.settings import ExactSettings

PREDICTION_MARGIN = 0.03
"""How far a predicted root may be off, metres: nearer than this to what could hold something it is followed."""


@dataclass(frozen=True)
class _Samples:
    """Samples of the rays that hit, before integration: [R, S], [R, S, 3], or [R, S, 1 + N] shares of the body and of
    each object; and normals [R, S, 3] in root space, of length one or zero, where asked for."""

    rgb: Tensor
    density: Tensor
    shares: Tensor
    converged: Tensor
    normal: Tensor | None


class ExactModel(nn.Module):
    """Skinning, offset, codes and field as one module; parameters' dtype must be the rays'."""

    def __init__(self, shape: ExactShape) -> None:
        super().__init__()
        self.shape = shape
        pose = pose_code_size(shape.bones, shape.object_slots)
        self.deform = ForwardSkinning(shape.deform, shape.bones + shape.object_slots, pose, shape.centre, shape.scale)
        self.codes = IdentityCodes(shape.n_persons, shape.n_objects, shape.code_size)
        condition = shape.code_size * (1 + shape.object_slots)
        self.field = RadianceField(shape.radiance, condition, pose, shape.centre, shape.scale)
        boxes = torch.tensor([shape.object_lower, shape.object_upper], dtype=torch.float64).reshape(2, -1, 3)
        self.register_buffer("object_boxes", boxes, persistent=False)
        corners = torch.tensor([shape.lower, shape.upper], dtype=torch.float64)
        self.register_buffer("corners", corners, persistent=False)
        self._predicted: tuple[PoseBatch, tuple[list[int], float, bool], Prediction] | None = None

    def canonical_boxes(self, poses: PoseBatch) -> Tensor:
        """[P, N, 2, 3] corners of every slot's object in canonical space; points where the model has no boxes."""
        offsets = torch.as_tensor(object_places(self.shape.object_distance, self.shape.object_slots)).to(poses.heads)
        places = (poses.heads[:, :1, :] + offsets)[:, :, None, :].expand(-1, -1, 2, -1)
        boxes = self.get_buffer("object_boxes").to(places)
        if boxes.shape[1] == 0:
            return places
        chosen = boxes[:, poses.objects.clamp(min=0)].permute(1, 2, 0, 3)
        return places + torch.where((poses.objects >= 0)[..., None, None], chosen, 0.0)

    def query_canonical(
        self,
        points: Tensor,
        covariances: Tensor,
        person_codes: Tensor,
        object_codes: Tensor,
        pose_codes: Tensor | None = None,
        *,
        identity_index: Tensor | None = None,
        pose_index: Tensor | None = None,
    ) -> FieldSample:
        """The field at canonical points.

        Args:
            points: [M, 3] metres; covariances: [M, 3, 3] or diagonals [M, 3].
            person_codes: [U, C]; object_codes: [U, N, C]; identity_index: [M], not needed where U is 1 or M.
            pose_codes: [P, pose code] and pose_index [M], or None for no occlusion.
        """
        identity = torch.cat([person_codes, object_codes.flatten(-2)], dim=-1)
        return self.field(
            points, covariances, identity, pose_codes, identity_index=identity_index, pose_index=pose_index
        )

    def find_canonical(self, targets: Tensor, poses: PoseBatch, index: Tensor, settings: ExactSettings) -> Roots:
        """Canonical roots of root-space points [M, 3] whose poses are ``index`` [M]; no graph."""
        starts, usable = bone_starts(
            targets,
            poses,
            index,
            count=settings.inverse.starts,
            object_boxes=self.canonical_boxes(poses),
            background=settings.inverse.background,
            size=self.shape.size,
        )
        empty = torch.zeros_like(usable[:, 0])
        prediction = None
        if settings.inverse.predict > 0:
            may_hold = partial(self.within_canonical_reach, poses=poses, margin=PREDICTION_MARGIN)
            # What decides where roots lie has to have the offset; what only leads to them is quicker without.
            moved = settings.roots == "grid" and settings.offset
            prediction = self._prediction(poses, settings.inverse.predict, moved)
            led = prediction.lead(targets, starts, usable, index, may_hold if settings.bounded else None)
            starts, usable, empty = led.starts, led.follow, led.empty

        def warp(x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
            if prediction is not None and settings.roots == "grid":
                return prediction.warp(x, index[rows])
            return self.deform.with_jacobian(x, poses, index[rows], settings.offset)

        size, inverse = self.shape.size, settings.inverse
        roots = find_roots(warp, targets, starts, usable, size=size, settings=inverse)
        if prediction is None:
            roots = look_between(warp, targets, starts, usable, roots, size=size, settings=inverse)
        return replace(roots, empty=empty)

    def _prediction(self, poses: PoseBatch, cell: float, offset: bool) -> Prediction:
        """The grid that leads starts, kept while the poses and the skinning are the same."""
        learned = self.deform if offset else self.deform.skinning
        versions = [parameter._version for parameter in learned.parameters()]
        state = (versions, cell, offset)
        if self._predicted is None or self._predicted[0] is not poses or self._predicted[1] != state:
            lower, upper = self.get_buffer("corners").to(poses.transforms)
            self._predicted = (poses, state, predict(self.deform, poses, lower, upper, cell, offset))
        return self._predicted[2]

    def within_reach(self, points: Tensor, poses: PoseBatch, index: Tensor) -> Tensor:
        """[M] bool: near enough to a bone or an object for anything to be there; what bounds rays, sample by sample."""
        return self._reached(bone_distances(points, poses, index, self.canonical_boxes(poses))[1])

    def within_canonical_reach(self, points: Tensor, index: Tensor, poses: PoseBatch, margin: float = 0.0) -> Tensor:
        """[M] bool: the same of canonical points, ``margin`` metres farther."""
        own = (poses.heads, poses.tails, self.canonical_boxes(poses), poses.present)
        if len(poses.heads) > 1:
            own = tuple(array.index_select(0, index) for array in own)  # type: ignore[assignment]
        return self._reached(canonical_distances(points[:, None].expand(-1, poses.present.shape[1], -1), *own), margin)

    def _reached(self, distance: Tensor, margin: float = 0.0) -> Tensor:
        """[M] bool of distances [M, J] to bones, then objects."""
        bones, objects = distance[:, : self.shape.bones], distance[:, self.shape.bones :]
        return (bones <= BODY_REACH + margin).any(dim=-1) | (objects <= OBJECT_MARGIN + margin).any(dim=-1)

    def render_rays(
        self,
        rays: RayBatch,
        poses: PoseBatch,
        persons: Tensor,
        objects: Tensor,
        settings: ExactSettings,
        generator: torch.Generator | None = None,
        *,
        orthographic: bool = False,
        facing: bool = False,
        chunk: int = 1024,
    ) -> RayResult:
        """Renders rays; in training mode with a graph and regularisers, else without and ``chunk`` rays at a time.

        Args:
            rays: root space; ``far <= near`` marks a miss, which costs nothing.
            poses: the poses that ``rays.pose`` points into.
            persons: [R], objects: [R, N] identities whose codes colour each ray (CIL's draw, or the poses' own).
            generator: jitters the samples when given.
            orthographic: the rays are cylinders of radius ``rays.radii``.
            facing: whether normals are wanted.

        Raises:
            ValueError: parameters of another dtype than the rays, or, in training, roots in a grid or rays that are not
                finite (when rendering these are transparent, of confidence 0, and count as failed).
        """
        if self.training and settings.roots == "grid":
            raise ValueError("the setting 'roots' is 'grid', which has no gradients: train with 'network'")
        parameter = next(self.parameters())
        if parameter.dtype != rays.origins.dtype:
            raise ValueError(
                f"rays are {rays.origins.dtype}, the model's parameters {parameter.dtype}: convert one of them"
            )
        edges = stratified_edges(rays.near, rays.far, settings.samples, generator)
        whole = torch.arange(len(rays.origins), device=rays.origins.device)
        with torch.set_grad_enabled(self.training and torch.is_grad_enabled()):
            parts = [
                self._render(
                    take_rays(rays, rows),
                    edges[rows],
                    poses,
                    codes=(persons[rows], objects[rows]),
                    settings=settings,
                    orthographic=orthographic,
                    facing=facing,
                )
                for rows in ([whole] if self.training else whole.split(chunk))
            ]
            result = join(parts)
            if self.training:
                result = replace(result, regularisers=self.regularisers(poses, generator))
        return result

    def regularisers(self, poses: PoseBatch, generator: torch.Generator | None = None) -> dict[str, Tensor]:
        """The training terms ``weights`` (L_w) and ``offset`` (L_Δ) of ``bone_regularisers``."""
        return bone_regularisers(self.deform, poses, self.canonical_boxes(poses), generator)

    def _render(
        self,
        rays: RayBatch,
        edges: Tensor,
        poses: PoseBatch,
        *,
        codes: tuple[Tensor, Tensor],
        settings: ExactSettings,
        orthographic: bool,
        facing: bool,
    ) -> RayResult:
        sound = finite(rays)
        if self.training and not bool(sound.all()):
            raise ValueError(f"{int((~sound).sum())} of {len(sound)} rays hold values that are not finite")
        hit = ((rays.far > rays.near) & sound).nonzero()[:, 0]
        result = empty_result(rays, sound, settings.samples, self.shape.object_slots, facing)
        if len(hit) == 0:
            return result
        codes = (codes[0][hit], codes[1][hit])
        depths, samples, light = self._along(
            take_rays(rays, hit), edges[hit], poses, codes, settings, orthographic, facing
        )
        normal = result.normal
        if normal is not None and samples.normal is not None:
            normal = normal.index_copy(0, hit, (light.weights[..., None] * samples.normal).sum(dim=-2))
        pixels = integrate(light.weights, samples.rgb, depths, samples.shares)
        return RayResult(
            rgb=result.rgb.index_copy(0, hit, pixels.rgb),
            alpha=result.alpha.index_copy(0, hit, pixels.alpha),
            depth=result.depth.index_copy(0, hit, pixels.depth),
            mattes=result.mattes.index_copy(0, hit, pixels.mattes),
            confidence=result.confidence.index_copy(0, hit, visible_confidence(light, samples.converged)),
            # Counts for now: chunks differ in how many rays hit.
            failed_share=result.failed_share
            + torch.stack([(~samples.converged).sum(), torch.tensor(samples.converged.numel()).to(hit)]),
            regularisers={},
            normal=normal,
        )

    def _along(
        self, rays: RayBatch, edges: Tensor, poses: PoseBatch, codes: tuple[Tensor, Tensor], settings: ExactSettings,
        orthographic: bool, facing: bool,
    ) -> tuple[Tensor, _Samples, RayWeights]:  # fmt: skip
        """Depths [R, S] of rays that hit, their samples, and the light along them."""
        frusta = cylinders if orthographic else conical_frusta
        depths, means, covariances = frusta(rays.origins, rays.directions, rays.radii, edges)
        samples = self._sample(
            means, covariances, rays.pose, poses, identity=self.codes(*codes), settings=settings, facing=facing
        )
        lengths = (edges[:, 1:] - edges[:, :-1]) * torch.linalg.vector_norm(rays.directions, dim=-1, keepdim=True)
        return depths, samples, ray_weights(samples.density, lengths)

    @torch.no_grad()
    def sample_rays(
        self, rays: RayBatch, poses: PoseBatch, persons: Tensor, objects: Tensor, settings: ExactSettings, *,
        orthographic: bool = False, facing: bool = False, chunk: int = 1024,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor | None]:  # fmt: skip
        """What finite rays that hit meet, to be integrated with what others meet.

        Args:
            rays, …: as ``render_rays`` takes them.

        Returns:
            depths [R, S] metres, opacities [R, S], straight colours [R, S, 3], shares of the person and of each object
            [R, S, 1 + N], and normals [R, S, 3] in root space where ``facing``.
        """
        edges = stratified_edges(rays.near, rays.far, settings.samples, None)
        parts = []
        for rows in torch.arange(len(rays.near), device=rays.near.device).split(chunk):
            part, codes = take_rays(rays, rows), (persons[rows], objects[rows])
            depths, samples, light = self._along(part, edges[rows], poses, codes, settings, orthographic, facing)
            parts.append((depths, light.opacity, samples.rgb, samples.shares, samples.normal))
        *columns, normals = zip(*parts, strict=True)
        depths, opacity, rgb, shares = (torch.cat(column) for column in columns)
        return depths, opacity, rgb, shares, torch.cat(normals) if facing else None

    def _sample(
        self,
        means: Tensor,
        covariances: Tensor,
        ray_pose: Tensor,
        poses: PoseBatch,
        *,
        identity: Tensor,
        settings: ExactSettings,
        facing: bool,
    ) -> _Samples:
        shape = means.shape[:2]
        targets, posed_covariances = means.reshape(-1, 3), covariances.reshape(-1, 3, 3)
        count = len(targets)
        ray = torch.arange(shape[0], device=means.device).repeat_interleave(shape[1])
        index = ray_pose[ray]
        reached = torch.arange(count, device=means.device)
        if settings.bounded:
            reached = self.within_reach(targets, poses, index).nonzero()[:, 0]
            targets, posed_covariances, ray, index = (a[reached] for a in (targets, posed_covariances, ray, index))
        roots = self.find_canonical(targets, poses, index, settings)
        chosen, usable = self._densest(roots, posed_covariances, identity, ray, poses, index, settings)
        rows = usable.nonzero()[:, 0]
        found, jacobian = roots.points[rows, chosen[rows]], roots.jacobians[rows, chosen[rows]]
        carried = _carry(posed_covariances[rows], jacobian, settings)
        if torch.is_grad_enabled():
            posed = self.deform(found, poses, index[rows], settings.offset)
            found, _ = attach_implicit_gradients(found, posed, targets[rows], jacobian)
        with _field_precision(found, settings):
            sample = self.field(
                found,
                carried,
                identity,
                poses.codes if settings.shading else None,
                identity_index=ray[rows],
                pose_index=index[rows],
            )
        weights = self.deform.weights(found, poses, index[rows])
        body, things = weights[:, : self.shape.bones], weights[:, self.shape.bones : -1]
        shares = torch.cat([body.sum(dim=-1, keepdim=True), things], dim=-1)
        normal = None
        if facing:
            normals = self._normals(found, carried, jacobian, identity, ray[rows])
            normal = means.new_zeros(count, 3).index_copy(0, reached[rows], normals).unflatten(0, shape)
        place = reached[rows]
        converged = torch.ones(count, dtype=torch.bool, device=means.device).index_copy(0, reached, roots.found)
        return _Samples(
            rgb=means.new_zeros(count, 3).index_copy(0, place, sample.rgb.to(means)).unflatten(0, shape),
            density=means.new_zeros(count).index_copy(0, place, sample.density.to(means)).unflatten(0, shape),
            shares=means.new_zeros(count, shares.shape[1]).index_copy(0, place, shares).unflatten(0, shape),
            converged=converged.unflatten(0, shape),
            normal=normal,
        )

    def _normals(
        self, points: Tensor, covariances: Tensor, jacobians: Tensor, identity: Tensor, index: Tensor
    ) -> Tensor:
        """[M, 3] root-space normals at canonical points: −∇σ of the posed field, J⁻ᵀ ∇σ_c, at length one or zero."""
        with torch.enable_grad():
            at = points.detach().requires_grad_()
            density = self.field.density(at, covariances.detach(), identity.detach(), index)
            (slope,) = torch.autograd.grad(density.sum(), at)
        turned = (inverse_3x3(jacobians).matrix.transpose(-1, -2) @ slope[..., None])[..., 0]
        return safe_divide(-turned, safe_norm(turned)[..., None])

    @torch.no_grad()
    def _densest(
        self,
        roots: Roots,
        covariances: Tensor,
        identity: Tensor,
        ray: Tensor,
        poses: PoseBatch,
        index: Tensor,
        settings: ExactSettings,
    ) -> tuple[Tensor, Tensor]:
        """Which root of each target has the highest density [M], and whether any lies inside canonical space [M]."""
        corners = self.get_buffer("corners").to(roots.points)
        inside = ((roots.points >= corners[0]) & (roots.points <= corners[1])).all(dim=-1)
        candidates = roots.distinct & inside
        if settings.bounded:
            target, start = candidates.nonzero(as_tuple=True)
            reached = self.within_canonical_reach(roots.points[target, start], index[target], poses)
            candidates[target, start] = reached
        usable = candidates.any(dim=-1)
        chosen = candidates.to(torch.int8).argmax(dim=-1)
        several = (candidates.sum(dim=-1) > 1)[:, None] & candidates
        target, start = several.nonzero(as_tuple=True)
        if len(target):
            density = covariances.new_full(candidates.shape, -torch.inf)
            carried = _carry(covariances[target], roots.jacobians[target, start], settings)
            with _field_precision(carried, settings):
                found = self.field.density(roots.points[target, start], carried, identity, ray[target])
            density[target, start] = found.to(density)
            chosen = torch.where(several.any(dim=-1), density.argmax(dim=-1), chosen)
        return chosen, usable


def _field_precision(like: Tensor, settings: ExactSettings) -> torch.autocast:
    """The arithmetic of the field's perceptrons."""
    return torch.autocast(like.device.type, torch.bfloat16, enabled=settings.field_precision == "bfloat16")


def _carry(covariances: Tensor, jacobians: Tensor, settings: ExactSettings) -> Tensor:
    """Σ_c = J⁻¹ Σ J⁻ᵀ; J is a constant here, as second derivatives of the skinning weights are not trained through."""
    if settings.covariance == "plain":
        return covariances
    inverse = inverse_3x3(jacobians).matrix
    return inverse @ covariances @ inverse.transpose(-1, -2)
