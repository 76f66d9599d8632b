// Threads that share work.
#pragma once

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace ctr {

// Hands the numbers below count to threads, each with a workspace of its own; the first failure is thrown at the end.
template <class Make, class Work>
void share(std::size_t count, int threads, const Make& make, const Work& work) {
    std::atomic<std::size_t> next{0};
    std::exception_ptr failure;
    std::mutex guard;
    auto run = [&] {
        try {
            const auto workspace = make();
            for (std::size_t k = next++; k < count; k = next++) work(*workspace, k);
        } catch (...) {
            const std::lock_guard lock(guard);
            if (!failure) failure = std::current_exception();
        }
    };
    const int wanted = threads > 0 ? threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
    const int used = static_cast<int>(std::min<std::size_t>(wanted, std::max<std::size_t>(count, 1)));
    std::vector<std::thread> pool;
    pool.reserve(used);
    try {
        for (int k = 1; k < used; ++k) pool.emplace_back(run);
    } catch (const std::system_error&) {  // no more threads to be had: those there are do the work
    }
    run();
    for (std::thread& thread : pool) thread.join();
    if (failure) std::rethrow_exception(failure);
}

}  // namespace ctr
