"""The translator from kernels to C99."""
