"""The real architectures, tiny and with random weights, in folders as their checkpoints are."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

HUBCONF = '''
import cv2
import numpy as np
import torch


class Network(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.least = torch.nn.Parameter(torch.zeros(1))


class Predictor(torch.nn.Module):
    """Takes and gives what CoTracker's predictor does; inside, flow from the query's frame on."""

    def __init__(self):
        super().__init__()
        self.model = Network()

    def forward(self, video, queries):
        frames = video[0].permute(0, 2, 3, 1).numpy().astype(np.uint8)
        gray = [cv2.cvtColor(np.ascontiguousarray(f), cv2.COLOR_RGB2GRAY) for f in frames]
        asked = queries[0].numpy()
        uv = np.repeat(asked[None, :, 1:], len(gray), axis=0)
        seen = np.arange(len(gray))[:, None] >= asked[None, :, 0]
        for t in range(1, len(gray)):
            moving = np.flatnonzero(asked[:, 0] < t)
            if moving.size:
                start = np.ascontiguousarray(uv[t - 1, moving][:, None])
                found, good, _ = cv2.calcOpticalFlowPyrLK(gray[t - 1], gray[t], start, None)
                uv[t, moving] = found[:, 0]
                seen[t, moving] &= (good[:, 0] > 0) & seen[t - 1, moving]
        return torch.from_numpy(uv)[None], torch.from_numpy(seen)[None]


def cotracker3_offline(*, pretrained=True):
    assert not pretrained, "nothing is to be downloaded"
    return Predictor()
'''


def sam2(folder: Path) -> Path:
    """A SAM 2 of 128 x 128 pixels."""
    transformers = pytest.importorskip("transformers", reason="transformers is not installed")
    backbone = transformers.Sam2HieraDetConfig(
        hidden_size=12,
        image_size=[128, 128],
        blocks_per_stage=[1, 1, 2, 1],
        embed_dim_per_stage=[12, 24, 48, 96],
        num_attention_heads_per_stage=[1, 2, 4, 8],
        window_size_per_stage=[8, 4, 14, 7],
        global_attention_blocks=[3],
    )
    vision = transformers.Sam2VisionConfig(
        backbone_config=backbone.to_dict(),
        backbone_channel_list=[96, 48, 24, 12],
        backbone_feature_sizes=[[32, 32], [16, 16], [8, 8]],
        fpn_hidden_size=32,
    )
    prompts = {"hidden_size": 32, "image_size": 128, "patch_size": 16, "mask_input_channels": 8}
    decoder = {"hidden_size": 32, "mlp_dim": 32, "num_attention_heads": 2}
    config = transformers.Sam2Config(
        vision_config=vision.to_dict(),
        prompt_encoder_config=prompts,
        mask_decoder_config=decoder | {"iou_head_hidden_dim": 32},
    )
    return _saved(transformers.Sam2Model(config), folder)


def dinov2(folder: Path, registers: bool = False) -> Path:
    """A DINOv2 of two layers, with or without registers."""
    transformers = pytest.importorskip("transformers", reason="transformers is not installed")
    sizes = {"hidden_size": 24, "num_hidden_layers": 2, "num_attention_heads": 2}
    sizes |= {"patch_size": 14, "image_size": 56}
    if registers:
        config = transformers.Dinov2WithRegistersConfig(**sizes, num_register_tokens=4)
        return _saved(transformers.Dinov2WithRegistersModel(config), folder)
    return _saved(transformers.Dinov2Model(transformers.Dinov2Config(**sizes)), folder)


def diffusion(folder: Path) -> Path:
    """A Stable Diffusion of four blocks, with all its parts."""
    diffusers = pytest.importorskip("diffusers", reason="diffusers is not installed")
    transformers = pytest.importorskip("transformers", reason="transformers is not installed")
    few = {"layers_per_block": 1, "norm_num_groups": 4}
    vae = diffusers.AutoencoderKL(
        block_out_channels=(8, 8, 8, 8),
        down_block_types=("DownEncoderBlock2D",) * 4,
        up_block_types=("UpDecoderBlock2D",) * 4,
        latent_channels=4,
        **few,
    )
    unet = diffusers.UNet2DConditionModel(
        block_out_channels=(8, 8, 16, 16),
        down_block_types=("CrossAttnDownBlock2D",) * 3 + ("DownBlock2D",),
        up_block_types=("UpBlock2D",) + ("CrossAttnUpBlock2D",) * 3,
        cross_attention_dim=16,
        attention_head_dim=4,
        **few,
    )
    _saved(vae, folder / "vae")
    _saved(unet, folder / "unet")
    diffusers.DDIMScheduler().save_pretrained(folder / "scheduler")
    _words(folder / "tokenizer")
    text = transformers.CLIPTextConfig(
        vocab_size=6,
        hidden_size=16,
        intermediate_size=16,
        num_hidden_layers=1,
        num_attention_heads=2,
        max_position_embeddings=8,
        bos_token_id=0,
        eos_token_id=1,
    )
    _saved(transformers.CLIPTextModel(text), folder / "text_encoder")
    return folder


def cotracker(folder: Path) -> tuple[Path, Path]:
    """A clone with the entry that CoTracker's has, and a checkpoint of its weights."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    folder.mkdir()
    (folder / "hubconf.py").write_text(HUBCONF)
    torch.save({"least": torch.ones(1)}, folder / "weights.pth")
    return folder, folder / "weights.pth"


def _words(folder: Path) -> None:
    import transformers

    folder.mkdir(parents=True)
    words = ["<|startoftext|>", "<|endoftext|>", "a", "b", "a</w>", "b</w>"]
    (folder / "vocab.json").write_text(json.dumps({word: i for i, word in enumerate(words)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    given = [str(folder / name) for name in ("vocab.json", "merges.txt")]
    transformers.CLIPTokenizer(*given).save_pretrained(folder)


def _saved(model: object, folder: Path) -> Path:
    model.save_pretrained(folder)
    return folder
