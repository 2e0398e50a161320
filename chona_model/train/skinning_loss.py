"""What keeps learned skinning sane: λ L_w + β L_Δ of the paper, for voxel volumes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from chona_model.data.dataset import Dataset
from chona_model.deform.voxels import bone_nodes
from chona_model.grid_model import GridModel, PosedFigure
from chona_model.train.fast_settings import FastSettings


class SkinningLoss:
    """Weights are one-hot on the bones (L_w), and offsets stay near zero (L_Δ).

    Args:
        dataset: whose rest joints say where the bones of its persons are; settings: λ and β.
    """

    def __init__(self, model: GridModel, dataset: Dataset, settings: FastSettings) -> None:
        self.model, self.settings = model, settings
        self.bones = {
            index: bone_nodes(model.grid(index), dataset.skeleton, dataset.persons[person.name].rest_joints)
            for index, person in enumerate(model.persons)
            if person.name in dataset.persons
        }

    def __call__(self, figures: Sequence[PosedFigure]) -> Tensor:
        """Of the persons that are posed."""
        total = self.model.real(np.zeros(()))
        for person in sorted({figure.person for figure in figures if figure.person >= 0}):
            volume = self.model.volume(person)
            nodes, bones = self.bones[person]
            weights = volume.logits[nodes].softmax(dim=1)
            one_hot = torch.nn.functional.one_hot(bones.to(weights.device), weights.shape[1])
            total = total + self.settings.weight_loss * ((weights - one_hot) ** 2).mean()
            codes = np.stack([figure.code for figure in figures if figure.person == person])
            offset = volume.offset(self.model.real(codes))
            if offset is not None:
                total = total + self.settings.offset_loss * (offset**2).mean()
        return total
