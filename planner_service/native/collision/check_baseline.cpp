#define KERNEL_VARIANT baseline
#include "check.inc"
