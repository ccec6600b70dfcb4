"""The same as on a real kit, on an emulated machine with the kernel's virtual cameras."""
