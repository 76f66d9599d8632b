// Solvers for whoever asks at the same time.
#pragma once

#include <exception>
#include <memory>
#include <mutex>
#include <vector>

#include "ctr/bound.hpp"
#include "model/share.hpp"

namespace ctr {

// Solvers of one robot, which must outlive the pool, kept with their memory from call to call.
class SolverPool {
  public:
    explicit SolverPool(const Robot& robot) : robot_(robot) {}

    // A solver borrowed for the length of a call.
    class Loan {
      public:
        explicit Loan(SolverPool& pool) : pool_(pool) {
            const std::lock_guard lock(pool.mutex_);
            if (!pool.solvers_.empty()) {
                solver_ = std::move(pool.solvers_.back());
                pool.solvers_.pop_back();
            }
            if (!solver_) solver_ = std::make_unique<BoundSolver>(pool.robot_);
        }
        ~Loan() {
            if (std::uncaught_exceptions() > exceptions_) return;  // left in the middle of a solve, or without memory for one
            const std::lock_guard lock(pool_.mutex_);
            pool_.solvers_.push_back(std::move(solver_));
        }
        BoundSolver* operator->() { return solver_.get(); }
        BoundSolver& operator*() { return *solver_; }

      private:
        SolverPool& pool_;
        std::unique_ptr<BoundSolver> solver_;
        const int exceptions_ = std::uncaught_exceptions();
    };

    // work(solver, k) for every k below count.
    template <class Work>
    void parallel(std::size_t count, int threads, const Work& work) {
        share(count, threads, [&] { return std::make_unique<Loan>(*this); }, [&](Loan& loan, std::size_t k) { work(*loan, k); });
    }

  private:
    const Robot& robot_;
    std::mutex mutex_;
    std::vector<std::unique_ptr<BoundSolver>> solvers_;
};

}  // namespace ctr
