#define KERNEL_VARIANT avx512
#include "check.inc"
