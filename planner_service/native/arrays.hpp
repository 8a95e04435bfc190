// Arrays of numbers as Python hands them over and gets them back, and a refusal of those that do not fit.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <stdexcept>
#include <type_traits>
#include <utility>
#include <vector>

namespace arrays {

template <class Number, std::size_t dimensions>
using Array = nanobind::ndarray<const Number, nanobind::ndim<dimensions>, nanobind::c_contig, nanobind::device::cpu>;

using Rows = Array<double, 2>;
using Row = Array<double, 1>;
using NumberRows = Array<std::int64_t, 2>;
using Numbers = Array<std::int64_t, 1>;

inline void require(bool condition, const char* what) {
    if (!condition) throw std::invalid_argument(what);
}

// A numpy array that keeps the numbers of a vector; read-only if ``Element`` is const.
template <class Element, class Number>
nanobind::object array_of(std::vector<Number>&& values, std::initializer_list<std::size_t> shape) {
    static_assert(std::is_same_v<std::remove_const_t<Element>, Number>);
    std::size_t size = 1;
    for (const std::size_t length : shape) size *= length;
    require(size == values.size(), "a shape for all numbers");
    auto* kept = new std::vector<Number>(std::move(values));
    const nanobind::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<Number>*>(p); });
    return nanobind::ndarray<nanobind::numpy, Element>(kept->data(), shape, owner).cast();
}

}  // namespace arrays
