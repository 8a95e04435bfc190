#pragma once

#include <nanobind/nanobind.h>

namespace search {

// Adds ``Oracle``, ``EdgeOracle``, ``TieredOracle`` and ``BalancedSearch``.
void bind(nanobind::module_& m);

}  // namespace search
