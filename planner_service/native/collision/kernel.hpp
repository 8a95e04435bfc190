#pragma once

#include <nanobind/nanobind.h>

#include "samples.hpp"

namespace collision {

// What a ``CollisionKernel`` is made of; it is there as long as that.
struct View {
    const Model& model;
    const Variant& variant;
    const Settings& settings;
};

// Of a ``CollisionKernel`` that is configured for edges.
View view_of(nanobind::handle kernel);

// Adds ``CollisionKernel``, what it answers, and ``instruction_sets``.
void bind(nanobind::module_& m);

}  // namespace collision
