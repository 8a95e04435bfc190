#define KERNEL_VARIANT avx2
#include "judge.inc"
