#!/usr/bin/env python3
"""Makes a TorchScript teacher for `lcdm-train teach` of a published MonoViT checkpoint (Zhao et al. 2022).

    git clone https://github.com/zxcqlf/MonoViT        # and what its README says it needs: torch, timm, mmcv, einops
    python3 model/teachers/monovit_to_torchscript.py --repository MonoViT --weights mono_640x192 --output monovit.pt
    lcdm-train teach --pack DIR --torchscript monovit.pt --size 640 192 --pixels unit --gives inverse

`--weights` is the folder with encoder.pth and depth.pth. The module takes RGB in [0, 1] and gives inverse depth in
1/m up to scale (Monodepth2's 0.1 to 100 m); learn from it with align = "scale". Published weights have a licence of
their own: see their project.
"""
import argparse
import pathlib
import sys
import unittest.mock

import torch

NEAREST, FARTHEST = 0.1, 100.0


class Teacher(torch.nn.Module):
    def __init__(self, encoder, decoder):
        super().__init__()
        self.encoder = encoder
        self.decoder = decoder

    def forward(self, rgb):
        disparity = self.decoder(self.encoder(rgb))[("disp", 0)]
        return 1 / FARTHEST + (1 / NEAREST - 1 / FARTHEST) * disparity


def load_teacher(repository, weights):
    """The teacher in evaluation mode, and the height and width it was trained at."""
    sys.path.insert(0, str(repository))
    import networks

    # The constructor asks for ImageNet weights, which the checkpoint replaces anyway.
    with unittest.mock.patch("torch.load", lambda *_, **__: {"model": {}}):
        encoder = networks.mpvit_small()
    encoder.num_ch_enc = [64, 128, 216, 288, 288]
    decoder = networks.DepthDecoder()
    saved = torch.load(weights / "encoder.pth", map_location="cpu")
    wanted = encoder.state_dict()
    missing = sorted(set(wanted) - set(saved))
    if missing:
        sys.exit(f"{weights}/encoder.pth lacks {len(missing)} tensors, such as {missing[0]}: is it MonoViT's?")
    encoder.load_state_dict({name: saved[name] for name in wanted})
    decoder.load_state_dict(torch.load(weights / "depth.pth", map_location="cpu"))
    return Teacher(encoder, decoder).eval(), int(saved["height"]), int(saved["width"])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repository", type=pathlib.Path, required=True)
    parser.add_argument("--weights", type=pathlib.Path, required=True)
    parser.add_argument("--output", type=pathlib.Path, required=True)
    options = parser.parse_args()
    teacher, height, width = load_teacher(options.repository, options.weights)
    example = torch.rand(1, 3, height, width)
    with torch.no_grad():
        module = torch.jit.trace(teacher, example)
        error = (module(example) - teacher(example)).abs().max().item()
    module.save(str(options.output))
    print(f"{options.output}: for pictures of {width}x{height}; differs from the model by {error:.2g} at most")


if __name__ == "__main__":
    main()
