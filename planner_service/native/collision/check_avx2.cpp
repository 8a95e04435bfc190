#define KERNEL_VARIANT avx2
#include "check.inc"
