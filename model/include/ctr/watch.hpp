// Whether work is still wanted: who waits for it is asked every tenth of a second or so, and may call it off.
#pragma once

#include <atomic>
#include <chrono>
#include <functional>

namespace ctr {

// Thrown out of work that is called off. Solvers it went through have to be thrown away or put back.
struct Interrupted {};

// Watches over the work of the thread that makes it, as long as it lives, and of the threads that join in.
class Watch {
  public:
    // Is told the finished share, 0 to 1, on the thread that made the watch; false calls the work off.
    using Ask = std::function<bool(double share)>;

    explicit Watch(Ask ask) : ask_(std::move(ask)), outer_(current_) { current_ = this; }
    ~Watch() { current_ = outer_; }
    Watch(const Watch&) = delete;
    Watch& operator=(const Watch&) = delete;

    // Throws Interrupted where the work is called off. Takes nanoseconds, so that every step of a solver may call it.
    static void look() {
        if (current_) current_->ask_if_due();
        else if (joined_ && joined_->called_off_.load(std::memory_order_relaxed)) throw Interrupted();
    }
    static void tell(double share) {
        if (current_) current_->share_ = share;
    }

    // Of the thread that hands out work; null if nobody watches.
    static Watch* over_this_thread() { return current_ ? current_ : joined_; }
    // A thread that does a part of the work.
    class Joined {
      public:
        explicit Joined(Watch* watch) : before_(joined_) { joined_ = watch; }
        ~Joined() { joined_ = before_; }

      private:
        Watch* before_;
    };

  private:
    void ask_if_due() {
        if (called_off_.load(std::memory_order_relaxed)) throw Interrupted();
        const auto now = std::chrono::steady_clock::now();
        if (now - asked_ < std::chrono::milliseconds(100)) return;
        asked_ = now;
        if (ask_(share_)) return;
        called_off_ = true;
        throw Interrupted();
    }

    Ask ask_;
    Watch* outer_;
    std::atomic<bool> called_off_{false};
    std::chrono::steady_clock::time_point asked_ = std::chrono::steady_clock::now();
    double share_ = 0;
    static thread_local inline Watch* current_ = nullptr;
    static thread_local inline Watch* joined_ = nullptr;
};

}  // namespace ctr
