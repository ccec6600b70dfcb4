"""Sub-maps of one known drive, each with its own frame, unit and projective distortion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.baselines.overlap import Correspondences
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.types import Submap

N_MAX, N_OVERLAP = 15, 3
CAMERA = Perspective.from_hfov(80, 640, 320)


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
        """Correspondences of world points (n, 3) in two sub-maps."""
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
    """Split T_w_p into sub-maps. bend: last row of a homography, per world unit."""
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
        cameras: tuple[Camera, ...] = (CAMERA,) * len(ids)
        if bend:
            cameras, T_s_p = bent(H, cameras, T_s_p)
        submaps.append(
            Submap(
                id=k,
                primary_ids=ids,
                assistant_ids=(),
                n_overlap=N_OVERLAP if k else 0,
                t_ns=np.array(ids, np.int64) * 100_000_000,
                T_s_c_raw=T_s_p,
                cameras_raw=cameras,
                T_s_c=T_s_p,
                cameras=cameras,
                scale=1 / scale,
                T_w_s=np.eye(4),
                focal_log_sigma=np.full(2, np.inf),
            )
        )
        T_s_w.append(H @ T)
    return Drive(T_w_p, submaps, np.array(T_s_w))


@dataclass(frozen=True, slots=True)
class Skewed(Perspective):
    """A pinhole camera with a skew, which a homography leaves in a projection matrix."""

    skew: float = 0.0

    @property
    def matrix(self) -> np.ndarray:
        return np.array([[self.fx, self.skew, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def project(self, p_c: np.ndarray) -> np.ndarray:
        q = p_c @ self.matrix.T
        return np.asarray(q[..., :2] / q[..., 2:])


def bent(
    H: np.ndarray, cameras: Sequence[Camera], T_s_p: np.ndarray
) -> tuple[tuple[Camera, ...], np.ndarray]:
    """Cameras and poses (N, 4, 4) that see H's points where the old saw theirs."""
    cameras_out, T_out = [], []
    for camera, T in zip(cameras, T_s_p, strict=True):
        P = camera.matrix @ np.linalg.inv(T)[:3] @ np.linalg.inv(H)
        M = P[:, :3] * np.sign(np.linalg.det(P[:, :3]))
        # by Cholesky: M M^T = K K^T with K upper triangular
        flip = np.eye(3)[::-1]
        lower = np.linalg.cholesky(flip @ M @ M.T @ flip)
        K_new = flip @ lower @ flip
        R = np.linalg.solve(K_new, M)
        T_out.append(se3.compose(R.T, -np.linalg.solve(P[:, :3], P[:, 3])))
        K = K_new / K_new[2, 2]
        optics = K[0, 0], K[1, 1], K[0, 2], K[1, 2], camera.width, camera.height
        cameras_out.append(Skewed(*optics, skew=K[0, 1]))
    return tuple(cameras_out), np.array(T_out)
