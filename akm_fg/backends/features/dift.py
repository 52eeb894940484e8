"""DIFT (Tang et al., "Emergent correspondence from image diffusion", 2023), the paper's features.

An image's latent is noised to step t, and the U-Net of Stable Diffusion is asked to take the noise
out again: what passes its second upward block is the feature, averaged over several draws of the
noise. The checkpoint is a local folder of Stable Diffusion 1.x or 2.x as diffusers keeps it (vae,
unet, scheduler, text_encoder, tokenizer).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akm_fg.backends.networks.crops import SquareCrop, require_same_size
from akm_fg.backends.networks.loading import checkpoint_folder, packages_of
from akm_fg.backends.networks.pretrained import BROKEN, first_line, pretrained
from akm_fg.backends.registry import BackendSettings
from akm_fg.errors import InputError
from akm_fg.interfaces import DenseFeatures, FeatureMap
from akm_fg.records import BoolArray

INSTALL = "install akm-fg[foundation] and a build of torch"
WHAT = "the folder of a Stable Diffusion model (vae, unet, scheduler, text_encoder, tokenizer)"
WHITE = 127.5  # pixels of 0..255 go to -1..1


@dataclass(frozen=True, slots=True)
class DiftConfig:
    """The settings of DIFT's authors for correspondence between objects."""

    checkpoint: str = ""  # folder
    side_px: int = 768  # as Stable Diffusion 2.1 was trained
    step: int = 261  # of the diffusion, of 1000
    block: int = 1  # of the U-Net's upward blocks, from 0
    draws: int = 8  # of the noise
    prompt: str = ""
    seed: int = 0  # of the noise: the same image gives the same features
    margin: float = 1.1  # of the crop around the mask
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.side_px < 1 or self.side_px % 64:
            raise ValueError(f"side_px {self.side_px}, expected a multiple of 64")
        if self.step < 0 or self.block < 0 or self.draws < 1 or not self.margin >= 1.0:
            numbers = f"step {self.step}, block {self.block}, draws {self.draws}"
            raise ValueError(f"{numbers}, margin {self.margin}: at least 0, 0, 1 and 1")


@dataclass(frozen=True, slots=True)
class Diffusion:
    """The parts of Stable Diffusion that are used."""

    vae: Any
    unet: Any
    scheduler: Any
    prompt: Any  # (1, L, D) embedded


class DiftFeatures:
    """`DenseFeatures` of a diffusion model."""

    def __init__(self, diffusion: Diffusion, config: DiftConfig) -> None:
        """Takes the parts with their weights."""
        self._parts, self.config = diffusion, config

    def describe(self, rgb: NDArray[np.uint8], mask: BoolArray) -> FeatureMap:
        """The features over the object.

        Raises:
            ValueError: sizes that differ, or a mask without a pixel.
        """
        require_same_size(rgb, mask)
        config = self.config
        crop = SquareCrop.around(mask, config.side_px, config.margin)
        picture = crop.cut(rgb).astype(np.float32).transpose(2, 0, 1)[None] / WHITE - 1.0
        features = self._features(np.ascontiguousarray(picture))
        made_by = f"dift-{features.shape[2]}/{config.block}/{config.step}/{config.side_px}"
        return crop.feature_map(features, mask, made_by)

    def _features(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """(h, w, C) of a picture (1, 3, side, side) of -1..1, mean over the draws."""
        import torch

        config, parts = self.config, self._parts
        caught: list[Any] = []
        hook = parts.unet.up_blocks[config.block].register_forward_hook(
            lambda _module, _given, out: caught.append(out)
        )
        rng = torch.Generator().manual_seed(config.seed)
        step = torch.tensor([config.step])
        try:
            with torch.inference_mode():
                image = torch.from_numpy(picture).to(config.device)
                latent = parts.vae.encode(image).latent_dist.mean * parts.vae.config.scaling_factor
                for _ in range(config.draws):
                    noise = torch.randn(latent.shape, generator=rng).to(config.device)
                    noisy = parts.scheduler.add_noise(latent, noise, step)
                    parts.unet(noisy, step.to(config.device), encoder_hidden_states=parts.prompt)
        finally:
            hook.remove()
        mean = torch.stack([out[0] for out in caught]).mean(dim=0)
        return np.ascontiguousarray(mean.permute(1, 2, 0).float().cpu().numpy())


def make(settings: BackendSettings) -> DenseFeatures:
    """The features, from the checkpoint that `stages.own.dift` names.

    Raises:
        InputError: no such checkpoint, or one that does not fit the settings.
        MissingDependency: torch, diffusers or transformers is not installed.
    """
    config = settings.own(DiftConfig())
    with packages_of("dift", INSTALL):
        from diffusers import AutoencoderKL, DDIMScheduler, UNet2DConditionModel
        from transformers import CLIPTextModel, CLIPTokenizer
    folder = checkpoint_folder(config.checkpoint, "stages.own.dift.checkpoint", WHAT)
    plainly = {"low_cpu_mem_usage": False}  # the other way needs one more package
    vae = pretrained(AutoencoderKL, folder / "vae", WHAT, config.device, **plainly)
    unet = pretrained(UNet2DConditionModel, folder / "unet", WHAT, config.device, **plainly)
    encoder = pretrained(CLIPTextModel, folder / "text_encoder", WHAT, config.device)
    try:
        scheduler = DDIMScheduler.from_pretrained(folder / "scheduler", local_files_only=True)
        words = CLIPTokenizer.from_pretrained(folder / "tokenizer", local_files_only=True)
        prompt = _embedded(config, encoder, words)
    except BROKEN as error:
        raise InputError(folder, f"cannot be loaded ({first_line(error)})", WHAT) from error
    if config.block >= len(unet.up_blocks) or config.step >= len(scheduler.alphas_cumprod):
        problem = (
            f"has {len(unet.up_blocks)} upward blocks and {len(scheduler.alphas_cumprod)} steps"
        )
        raise InputError(folder, problem, f"more than {config.block} and {config.step}")
    return DiftFeatures(Diffusion(vae, unet, scheduler, prompt), config)


def _embedded(config: DiftConfig, encoder: Any, words: Any) -> Any:
    """(1, L, D) of the prompt, as the U-Net was trained: padded to the encoder's length."""
    import torch

    length = int(encoder.config.max_position_embeddings)
    tokens = words(
        config.prompt, padding="max_length", max_length=length, truncation=True, return_tensors="pt"
    )
    with torch.inference_mode():
        return encoder(tokens.input_ids.to(config.device)).last_hidden_state
