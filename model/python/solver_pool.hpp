// Solvers for whoever asks at the same time, and threads that share work.
#pragma once

#include <algorithm>
#include <atomic>
#include <exception>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#include "ctr/bound.hpp"

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

// Solvers of one robot, which must outlive the pool, kept with their memory from call to call.
class SolverPool {
  public:
    explicit SolverPool(const ctr::Robot& robot) : robot_(robot) {}

    // A solver borrowed for the length of a call.
    class Loan {
      public:
        explicit Loan(SolverPool& pool) : pool_(pool) {
            const std::lock_guard lock(pool.mutex_);
            if (!pool.solvers_.empty()) {
                solver_ = std::move(pool.solvers_.back());
                pool.solvers_.pop_back();
            }
            if (!solver_) solver_ = std::make_unique<ctr::BoundSolver>(pool.robot_);
        }
        ~Loan() {
            const std::lock_guard lock(pool_.mutex_);
            pool_.solvers_.push_back(std::move(solver_));
        }
        ctr::BoundSolver* operator->() { return solver_.get(); }
        ctr::BoundSolver& operator*() { return *solver_; }

      private:
        SolverPool& pool_;
        std::unique_ptr<ctr::BoundSolver> solver_;
    };

    // work(solver, k) for every k below count.
    template <class Work>
    void parallel(std::size_t count, int threads, const Work& work) {
        share(count, threads, [&] { return std::make_unique<Loan>(*this); }, [&](Loan& loan, std::size_t k) { work(*loan, k); });
    }

  private:
    const ctr::Robot& robot_;
    std::mutex mutex_;
    std::vector<std::unique_ptr<ctr::BoundSolver>> solvers_;
};
