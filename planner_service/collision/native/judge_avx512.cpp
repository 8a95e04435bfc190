#define KERNEL_VARIANT avx512
#include "judge.inc"
