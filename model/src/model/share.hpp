// Threads that share work.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#include "ctr/watch.hpp"

namespace ctr {

// Hands the numbers below count to threads, each with a workspace of its own; the first failure ends the work and is thrown.
template <class Make, class Work>
void share(std::size_t count, int threads, const Make& make, const Work& work) {
    std::atomic<std::size_t> next{0};
    std::exception_ptr failure;
    std::mutex guard;
    auto fail = [&] {
        const std::lock_guard lock(guard);
        if (!failure) failure = std::current_exception();
        next = count;
    };
    auto run = [&] {
        try {
            const auto workspace = make();
            for (std::size_t k = next++; k < count; k = next++) {
                Watch::look();
                Watch::tell(static_cast<double>(k) / static_cast<double>(count));
                work(*workspace, k);
            }
        } catch (...) {
            fail();
        }
    };
    const int wanted = threads > 0 ? threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
    const int used = static_cast<int>(std::min<std::size_t>(wanted, std::max<std::size_t>(count, 1)));
    Watch* const watch = Watch::over_this_thread();
    std::condition_variable ended;
    int working = 0;
    std::vector<std::thread> pool;
    pool.reserve(used);
    try {
        for (int k = 1; k < used; ++k) {
            {
                const std::lock_guard lock(guard);
                ++working;
            }
            pool.emplace_back([&] {
                const Watch::Joined joined(watch);
                run();
                const std::lock_guard lock(guard);
                --working;
                ended.notify_one();
            });
        }
    } catch (const std::system_error&) {  // no more threads to be had: those there are do the work
        const std::lock_guard lock(guard);
        --working;
    }
    run();
    for (std::unique_lock lock(guard); working > 0;) {  // asking on, while others finish
        if (ended.wait_for(lock, std::chrono::milliseconds(50), [&] { return working == 0; })) break;
        lock.unlock();
        try {
            Watch::look();
        } catch (...) {
            fail();
        }
        lock.lock();
    }
    for (std::thread& thread : pool) thread.join();
    if (failure) std::rethrow_exception(failure);
}

}  // namespace ctr
