"""Train encoder and refinement on rendered clips, continuing from the newest checkpoint.

    python train.py --clips build/clips --out build/calm-geo --minutes 25

On a GPU: --batch 64 --points 512. Writes checkpoint.pt (under 16 MiB) and curves.csv.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import torch
from network import COARSE_STRIDE, FINE_STRIDE, Encoder, Refine, correlations, sample
from pairs import Clips, Pairs, batches
from torch import Tensor, nn
from torch.nn import functional as F

TEMPERATURE = 0.05
GUESS_NOISE_PX = 5.0
RELIABLE_PX = 8.0
WARM_UP = 200
CURVES = "step,seconds,loss,coarse,within_a_cell,refine_median_px,refine_1px,reliability_loss"


class Model(nn.Module):
    """All trained parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Encoder()
        self.refine = Refine()


def coarse_target(uv: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Flat indices (B, N, 4) of the four cells around uv (B, N, 2) px, and bilinear weights."""
    cells = ((uv + 0.5) / COARSE_STRIDE - 0.5).clamp(min=0)
    limit = torch.tensor([width - 1, height - 1], device=uv.device)
    cells = torch.minimum(cells, limit.float())
    low = torch.minimum(cells.floor(), limit - 1).clamp(min=0)
    part = cells - low
    x, y = low.long().unbind(-1)
    index = torch.stack(
        [y * width + x, y * width + x + 1, (y + 1) * width + x, (y + 1) * width + x + 1], -1
    )
    fx, fy = part.unbind(-1)
    share = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], -1)
    return index, share


def losses(model: Model, pairs: Pairs) -> tuple[Tensor, dict[str, float]]:
    """Total loss, and the figures for curves.csv."""
    n = len(pairs.a)
    with torch.autocast(pairs.a.device.type, torch.bfloat16):
        features = model.encoder(torch.cat([pairs.a, pairs.b]))
    coarse, reliability, fine, _ = (f.float() for f in features)
    coarse_b = coarse[n:]
    height, width = coarse_b.shape[-2:]
    query = F.normalize(sample(coarse[:n], pairs.uv_a, COARSE_STRIDE), dim=2)
    logits = query @ coarse_b.flatten(2) / TEMPERATURE
    log_p = F.log_softmax(logits, -1)
    index, share = coarse_target(pairs.uv_b, height, width)
    seen = pairs.seen.float()
    total = seen.sum().clamp(min=1)
    coarse_loss = (-(log_p.gather(2, index) * share).sum(-1) * seen).sum() / total
    best = logits.argmax(-1)
    at = (torch.stack([best % width, best // width], -1) + 0.5) * COARSE_STRIDE - 0.5
    right = ((at - pairs.uv_b).norm(dim=-1) < RELIABLE_PX) & pairs.seen
    # train reliability on visible points, and on moving and reflecting ones as unreliable
    used = (pairs.seen | ~pairs.steady).float()
    claim = sample(reliability[:n], pairs.uv_a, COARSE_STRIDE)[..., 0].clamp(1e-4, 1 - 1e-4)
    reliability_loss = (
        F.binary_cross_entropy(claim, right.float(), reduction="none") * used
    ).sum() / used.sum()
    guess = pairs.uv_b + torch.randn_like(pairs.uv_b) * GUESS_NOISE_PX
    there, here = correlations(fine[:n], pairs.uv_a, fine[n:], guess)
    flat = pairs.seen.reshape(-1)
    offset, log_sigma = model.refine(there.flatten(0, 1)[flat], here.flatten(0, 1)[flat])
    wanted = ((pairs.uv_b - guess) / FINE_STRIDE).reshape(-1, 2)[flat]
    error = (offset - wanted).norm(dim=1)
    inside = (wanted.abs() < 4).all(1)
    # negative log-likelihood of a two-dimensional Laplace distribution, robust to wrong matches
    refine_loss = (error * torch.exp(-log_sigma) + 2 * log_sigma)[inside].mean()
    loss = coarse_loss + 0.5 * refine_loss + 0.3 * reliability_loss
    px = error[inside].detach() * FINE_STRIDE
    return loss, {
        "loss": loss.item(),
        "coarse": coarse_loss.item(),
        "within_a_cell": (right.float().sum() / total).item(),
        "refine_median_px": px.median().item(),
        "refine_1px": (px < 1).float().mean().item(),
        "reliability_loss": reliability_loss.item(),
    }


def _rate(step: int, minutes: float, began: float, peak: float) -> float:
    """Learning rate: warm-up, then cosine decay over the given minutes."""
    done = min(1.0, (time.monotonic() - began) / (60 * minutes))
    return (
        peak * min(1.0, (step + 1) / WARM_UP) * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * done)))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clips", type=Path, default=Path("build/clips"))
    parser.add_argument("--out", type=Path, default=Path("build/calm-geo"))
    parser.add_argument("--minutes", type=float, default=25.0)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--points", type=int, default=256)
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)
    arguments.out.mkdir(parents=True, exist_ok=True)
    device = torch.device(arguments.device)
    model = Model().to(device).to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(model.parameters(), lr=arguments.rate, weight_decay=1e-4)
    checkpoint, step, before = arguments.out / "checkpoint.pt", 0, 0.0
    if checkpoint.exists():
        state = torch.load(checkpoint, map_location=device)
        model.load_state_dict(state["model"])
        optimiser.load_state_dict(state["optimiser"])
        step, before = state["step"], state["seconds"]
    clips = Clips(arguments.clips)
    clips.refresh()
    curves = arguments.out / "curves.csv"
    if not curves.exists():
        curves.write_text(CURVES + "\n")
    began = last = time.monotonic()
    sums: dict[str, float] = {}
    first = summed = step
    for pairs in batches(clips, arguments.batch, arguments.points, arguments.seed + step):
        moved = Pairs(*(getattr(pairs, name).to(device) for name in Pairs.__dataclass_fields__))
        for group in optimiser.param_groups:
            group["lr"] = _rate(step - first, arguments.minutes, began, arguments.rate)
        loss, shown = losses(model, moved)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        step += 1
        for name, value in shown.items():
            sums[name] = sums.get(name, 0.0) + value
        now = time.monotonic()
        ends = now - began > 60 * arguments.minutes
        if step % 50 == 0:
            seconds = before + now - began
            means = [v / (step - summed) for v in sums.values()]
            row = [f"{step}", f"{seconds:.0f}", *(f"{mean:.4f}" for mean in means)]
            with curves.open("a") as file:
                file.write(",".join(row) + "\n")
            print(*row, flush=True)
            sums, summed = {}, step
        if ends or now - last > 120:
            last = now
            clips.refresh()
            state = {"model": model.state_dict(), "optimiser": optimiser.state_dict(), "step": step}
            part = checkpoint.with_suffix(".part")
            torch.save({**state, "seconds": before + now - began}, part)
            part.rename(checkpoint)
        if ends:
            return


if __name__ == "__main__":
    main()
