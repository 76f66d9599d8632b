// Array of doubles aligned for the widest lanes; grows, never shrinks, so that solves after the first do not allocate.
#pragma once

#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>

#include "ctr/kernel.hpp"

namespace ctr {

class AlignedArray {
  public:
    // Contents are undefined after growth.
    void resize(std::size_t count) {
        size_ = count;
        if (count <= capacity_) return;
        const std::size_t bytes = (count * sizeof(double) + kAlignment - 1) / kAlignment * kAlignment;
        data_.reset(static_cast<double*>(std::aligned_alloc(kAlignment, bytes)));
        if (!data_) throw std::bad_alloc();
        capacity_ = bytes / sizeof(double);
    }
    void fill(double value) {
        for (std::size_t i = 0; i < size_; ++i) data_.get()[i] = value;
    }
    double* data() { return data_.get(); }
    const double* data() const { return data_.get(); }
    double& operator[](std::size_t i) { return data_.get()[i]; }
    double operator[](std::size_t i) const { return data_.get()[i]; }
    std::size_t size() const { return size_; }

  private:
    struct Free {
        void operator()(double* p) const { std::free(p); }
    };
    std::unique_ptr<double, Free> data_;
    std::size_t size_ = 0, capacity_ = 0;
};

}  // namespace ctr
