"""Other systems to run on the same pictures: ORB-SLAM3 and COLMAP.

Each runs as a process in a Python environment of its own under build/rivals, made at first use. If
that fails, the rival is skipped with the reason.
"""
