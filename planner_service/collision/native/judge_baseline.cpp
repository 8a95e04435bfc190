#define KERNEL_VARIANT baseline
#include "judge.inc"
