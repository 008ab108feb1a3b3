// Hold Stage to a multiple of real time: in the world file, in one model,
//
//     ctrl "throttle 5"         five times real time
//     ctrl "throttle auto 0.2"  as fast as the robots, which decide every 0.2 s, keep up with
//
// Headless, Stage runs as fast as the machine does, hundreds of times real time, and waits for no
// robot. With auto it begins at twice real time and measures how long after the last step's scans
// velocities come: such a step then takes twice as long as the slowest of the last ones. It writes
// how fast that is whenever it changes by a quarter. Build it beside the world file and name its
// folder in STAGEPATH:
//
//     uses=$(pkg-config --cflags stage roscpp geometry_msgs)
//     g++ -O2 -shared -fPIC $uses -o throttle.so throttle.cc

#include <geometry_msgs/Twist.h>
#include <ros/ros.h>
#include <stage.hh>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <deque>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace {

using Clock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

const Seconds FORGIVEN(0.5);  // of delay that is made up for; of a longer one nothing is
const double FIRST = 2, SLOWEST = 0.5, FASTEST = 100;  // times real time, with auto
const double SLACK = 2;                                // a step takes so many times an answer
const size_t REMEMBERED = 100;                         // steps with answers
const size_t ENOUGH = 10;                              // of them, before it is faster than FIRST
const size_t PAUSE = 5;                                // steps without an answer: no trial is played
const double TOLD = 1.25;                              // a change of the rate by this factor

// What the robots keep up with, by when velocities arrive after the scans of a step.
class Pace {
  public:
    explicit Pace(Stg::usec_t step_us) : step_us(step_us) {}

    void begin(Stg::World *world) {
        int robots = 0;
        world->ForEachDescendant(count, &robots);
        for (int robot = 0; robot < robots; ++robot) {
            const std::string space = robots == 1 ? "" : "robot_" + std::to_string(robot) + "/";
            const boost::function<void(const geometry_msgs::Twist::ConstPtr &)> came =
                [this](const geometry_msgs::Twist::ConstPtr &) { answered(); };
            topics.push_back(node.subscribe<geometry_msgs::Twist>(space + "cmd_vel", 10, came));
        }
        world->AddUpdateCallback(published, this);  // after stageros, which publishes in its own
    }

    double rate() {
        const std::lock_guard<std::mutex> lock(mutex);
        if (slowest.empty())
            return FIRST;
        const double answer = std::max(*std::max_element(slowest.begin(), slowest.end()), 1e-6);
        const double most = slowest.size() < ENOUGH ? FIRST : FASTEST;
        const double rate = std::min(std::max(step_us / 1e6 / (SLACK * answer), SLOWEST), most);
        if (std::abs(std::log(rate / told)) > std::log(TOLD)) {
            told = rate;
            std::printf("throttle: %.2g times real time: robots answer within %.2g s\n", rate, answer);
            std::fflush(stdout);
        }
        return rate;
    }

  private:
    static int count(Stg::Model *model, void *robots) {
        *static_cast<int *>(robots) += dynamic_cast<Stg::ModelPosition *>(model) != nullptr;
        return 0;
    }

    static int published(Stg::World *world, void *self) {
        static_cast<Pace *>(self)->step(world);
        return 0;  // call again
    }

    void step(const Stg::World *world) {
        if (world->SimTimeNow() % step_us != 0)
            return;
        const std::lock_guard<std::mutex> lock(mutex);
        if (unanswered.size() > PAUSE)
            paused = true;
        if (paused)
            unanswered.clear();
        unanswered.push_back(Clock::now());
    }

    // The first velocity of a step answers the oldest step since the last one; others are later. The
    // one that ends a pause may answer any step.
    void answered() {
        const std::lock_guard<std::mutex> lock(mutex);
        const Clock::time_point now = Clock::now();
        if (paused) {
            paused = false;
            since = now;
            unanswered.clear();
        } else if (!unanswered.empty()) {
            since = unanswered.front();
            unanswered.clear();
            slowest.push_back(0);
            if (slowest.size() > REMEMBERED)
                slowest.pop_front();
        }
        if (!slowest.empty())  // no step was published since: it is another robot's
            slowest.back() = std::max(slowest.back(), Seconds(now - since).count());
    }

    const Stg::usec_t step_us;
    ros::NodeHandle node;
    std::vector<ros::Subscriber> topics;
    std::mutex mutex;
    std::deque<Clock::time_point> unanswered;  // when scans of steps were published
    Clock::time_point since;
    bool paused = true;
    std::deque<double> slowest;  // answer, s, of each of the last steps
    double told = FIRST;
};

struct Throttle {
    double rate;
    Pace *pace;  // null: the rate is fixed
    Clock::time_point due;

    // Wait until the step that was just computed is over in real time.
    void wait(const Stg::World *world) {
        if (pace != nullptr)
            rate = pace->rate();
        const Seconds step(world->sim_interval / 1e6 / rate);
        const Clock::time_point now = Clock::now();
        if (due + FORGIVEN < now)
            due = now;
        due += std::chrono::duration_cast<Clock::duration>(step);
        std::this_thread::sleep_until(due);
    }
};

int updated(Stg::Model *model, void *throttle) {
    static_cast<Throttle *>(throttle)->wait(model->GetWorld());
    return 0;  // call again
}

// Subscribe after stageros did, which waits for the first update.
int begin(Stg::Model *model, void *pace) {
    static_cast<Pace *>(pace)->begin(model->GetWorld());
    return 1;  // once
}

}  // namespace

extern "C" int Init(Stg::Model *model, Stg::CtrlArgs *args) {
    double rate = FIRST, step_s = 0;
    Pace *pace = nullptr;
    const char *words = args->worldfile.c_str();
    if (std::sscanf(words, "%*s auto %lf", &step_s) == 1 && step_s > 0) {
        pace = new Pace(Stg::usec_t(step_s * 1e6 + 0.5));
        model->AddCallback(Stg::Model::CB_UPDATE, begin, pace);
    } else if (std::sscanf(words, "%*s %lf", &rate) != 1 || !(rate > 0)) {
        std::fprintf(stderr, "throttle: expected ctrl \"throttle RATE\", RATE above 0, or \"throttle auto SECONDS\"\n");
        return 1;
    }
    std::printf("throttle: %g times real time\n", rate);
    model->AddCallback(Stg::Model::CB_UPDATE, updated, new Throttle{rate, pace, Clock::now()});
    model->Subscribe();  // a model without subscribers is not updated
    return 0;
}
