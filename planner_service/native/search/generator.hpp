// Random numbers that are the same on every machine: xoshiro256++ (Blackman & Vigna, ACM TOMS 47(4), 2021), its state drawn
// by splitmix64 from the seed, as its authors advise.
#pragma once

#include <cstdint>

namespace search {

class Generator {
  public:
    explicit Generator(std::uint64_t seed) {
        for (auto& word : state_) {
            seed += 0x9e3779b97f4a7c15ULL;
            std::uint64_t z = seed;
            z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
            z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
            word = z ^ (z >> 31);
        }
    }

    // In [0, 1), a multiple of 2^-53.
    double uniform() {
        const std::uint64_t sum = turned(state_[0] + state_[3], 23) + state_[0], kept = state_[1] << 17;
        state_[2] ^= state_[0];
        state_[3] ^= state_[1];
        state_[1] ^= state_[2];
        state_[0] ^= state_[3];
        state_[2] ^= kept;
        state_[3] = turned(state_[3], 45);
        return static_cast<double>(sum >> 11) * 0x1.0p-53;
    }

  private:
    static std::uint64_t turned(std::uint64_t x, int k) { return (x << k) | (x >> (64 - k)); }
    std::uint64_t state_[4];
};

}  // namespace search
