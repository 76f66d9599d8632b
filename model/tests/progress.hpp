// How far a long run is: a line on the error stream each time another twentieth of it is done, ten seconds after the last at
// the earliest.
#pragma once

#include <chrono>
#include <cstdio>
#include <mutex>

namespace tests {

class Progress {
  public:
    explicit Progress(int total) : total_(total) {}

    void advance() {
        const std::lock_guard<std::mutex> lock(mutex_);
        ++done_;
        const auto now = Clock::now();
        if (done_ * 20LL / total_ == told_ || now - last_ < std::chrono::seconds(10)) return;
        told_ = done_ * 20LL / total_;
        last_ = now;
        std::fprintf(stderr, "%d of %d, %.0f s\n", done_, total_, std::chrono::duration<double>(now - start_).count());
    }

  private:
    using Clock = std::chrono::steady_clock;
    const int total_;
    const Clock::time_point start_ = Clock::now();
    Clock::time_point last_ = start_;
    int done_ = 0;
    long long told_ = 0;
    std::mutex mutex_;
};

}  // namespace tests
