"""Other systems run on the same pictures: ORB-SLAM3 and COLMAP.

Each runs as a process in its own Python environment under build/rivals, made at first use; if that
fails the rival is skipped with the reason.
"""
