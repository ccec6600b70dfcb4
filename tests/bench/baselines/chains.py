"""Sub-maps of one known drive, each in a frame, unit and projective bend of its own."""

from dataclasses import dataclass

import numpy as np

from bench.baselines.overlap import Correspondences
from calm_edge.geometry import pinhole, se3
from calm_edge.types import Submap

N_MAX, N_OVERLAP = 15, 3
K = pinhole.from_hfov(80, 640, 320)


@dataclass(frozen=True)
class Drive:
    """T_w_p (N, 4, 4) of every keyframe, the sub-maps, and T_s_w (S, 4, 4) homogeneous."""

    T_w_p: np.ndarray
    submaps: list[Submap]
    T_s_w: np.ndarray

    def points(self, k: int, n: int = 200) -> np.ndarray:
        """(n, 3) world points in front of the first camera of the k-th sub-map's overlap."""
        first = self.submaps[k].primary_ids[0]
        return se3.transform(self.T_w_p[first], points(n, seed=k))

    def matches(self, previous: int, new: int, p_w: np.ndarray) -> Correspondences:
        """What two sub-maps make of world points (n, 3)."""
        return Correspondences(
            moved(self.T_s_w[previous], p_w), moved(self.T_s_w[new], p_w), np.ones(len(p_w))
        )

    def overlaps(self) -> list[Correspondences]:
        return [self.matches(k - 1, k, self.points(k)) for k in range(1, len(self.submaps))]


def points(n: int = 200, seed: int = 0) -> np.ndarray:
    """(n, 3) scattered in front of a camera."""
    return np.random.default_rng(seed).uniform([-8, -3, 3], [8, 2, 30], (n, 3))


def moved(T: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Homogeneous T (4, 4) applied to points (n, 3)."""
    q = np.column_stack([p, np.ones(len(p))]) @ T.T
    return q[:, :3] / q[:, 3:]


def drive(T_w_p: np.ndarray, scale_log_sigma: float = 0.3, bend: float = 0.0) -> Drive:
    """Cuts T_w_p into sub-maps; bend: of the last row of a homography, per world unit."""
    rng = np.random.default_rng(11)
    submaps, T_s_w = [], []
    for k, start in enumerate(range(0, len(T_w_p) - N_OVERLAP, N_MAX - N_OVERLAP)):
        ids = tuple(range(start, min(start + N_MAX, len(T_w_p))))
        scale = np.exp(scale_log_sigma * rng.standard_normal())
        T = np.diag([scale] * 3 + [1.0]) @ se3.inverse(T_w_p[start])
        H = np.eye(4)
        if k:
            H[3, :3] = bend * rng.uniform(-1, 1, 3) / scale
        T_s_p = se3.inverse(T_w_p[start]) @ T_w_p[list(ids)]
        T_s_p[:, :3, 3] *= scale
        Ks = np.tile(K, (len(ids), 1, 1))
        if bend:
            Ks, T_s_p = bent(H, Ks, T_s_p)
        submaps.append(
            Submap(
                id=k,
                primary_ids=ids,
                assistant_ids=(),
                n_overlap=N_OVERLAP if k else 0,
                t_ns=np.array(ids, np.int64) * 100_000_000,
                T_s_c_raw=T_s_p,
                K_raw=Ks,
                T_s_c=T_s_p,
                K=Ks,
                scale=1 / scale,
                T_w_s=np.eye(4),
                focal_log_sigma=np.full(2, np.inf),
            )
        )
        T_s_w.append(H @ T)
    return Drive(T_w_p, submaps, np.array(T_s_w))


def bent(H: np.ndarray, Ks: np.ndarray, T_s_p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """K (N, 3, 3) and poses (N, 4, 4) whose projections see H's points where the old saw theirs."""
    K_out, T_out = [], []
    for K_i, T in zip(Ks, T_s_p, strict=True):
        P = K_i @ np.linalg.inv(T)[:3] @ np.linalg.inv(H)
        M = P[:, :3] * np.sign(np.linalg.det(P[:, :3]))
        # by Cholesky: M M^T = K K^T with K upper triangular
        flip = np.eye(3)[::-1]
        lower = np.linalg.cholesky(flip @ M @ M.T @ flip)
        K_new = flip @ lower @ flip
        R = np.linalg.solve(K_new, M)
        T_out.append(se3.compose(R.T, -np.linalg.solve(P[:, :3], P[:, 3])))
        K_out.append(K_new / K_new[2, 2])
    return np.array(K_out), np.array(T_out)
