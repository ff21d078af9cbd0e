"""Actions go in as torch tensors; images, rewards and infos come out as tensors of one device.

The same worlds as ``world.env``, stepped by MuJoCo Warp and drawn where they were stepped, so that
nothing passes through the host. Importing this package imports neither torch nor Warp.
"""
