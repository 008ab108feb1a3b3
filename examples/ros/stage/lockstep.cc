// Have stageros wait for the robots: in the world file, in one model,
//
//     ctrl "lockstep 0.2"
//
// Every 0.2 s of simulated time it goes on only when each robot was sent a velocity since it
// stopped. There it answers the service /lockstep/reset: all robots are put back, at rest, and
// velocities that came before are forgotten. Use it with zswarm's profile stage-lockstep, and with
// base_watchdog_timeout 0. Build it beside the world file and name its folder in STAGEPATH:
//
//     uses=$(pkg-config --cflags stage roscpp geometry_msgs std_srvs)
//     g++ -O2 -shared -fPIC $uses -o lockstep.so lockstep.cc

#include <geometry_msgs/Twist.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <stage.hh>
#include <std_srvs/Empty.h>

#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace {

const std::chrono::milliseconds POLL(100);  // between checks whether ROS ends

class Lockstep {
  public:
    explicit Lockstep(Stg::usec_t step_us) : step_us(step_us), spinner(1, &resets) {}

    // Subscribe after stageros did, so that it has a velocity before it is counted here.
    void begin(Stg::World *world) {
        world->ForEachDescendant(collect, &starts);
        for (size_t robot = 0; robot < starts.size(); ++robot) {
            const std::string space = starts.size() == 1 ? "" : "robot_" + std::to_string(robot) + "/";
            const boost::function<void(const geometry_msgs::Twist::ConstPtr &)> came =
                [this, robot](const geometry_msgs::Twist::ConstPtr &) { take(robot); };
            topics.push_back(node.subscribe<geometry_msgs::Twist>(space + "cmd_vel", 10, came));
        }
        ros::NodeHandle apart;  // stageros' queue is not to wait for a reset
        apart.setCallbackQueue(&resets);
        service = apart.advertiseService("lockstep/reset", &Lockstep::ask_reset, this);
        spinner.start();
        world->AddUpdateCallback(published, this);  // after stageros, which publishes in its own
    }

  private:
    using Starts = std::vector<std::pair<Stg::ModelPosition *, Stg::Pose>>;

    static int collect(Stg::Model *model, void *starts) {
        if (auto *robot = dynamic_cast<Stg::ModelPosition *>(model))
            static_cast<Starts *>(starts)->emplace_back(robot, robot->GetPose());
        return 0;
    }

    static int published(Stg::World *world, void *self) {
        static_cast<Lockstep *>(self)->wait(world);
        return 0;  // call again
    }

    void take(size_t robot) {
        const std::lock_guard<std::mutex> lock(mutex);
        driven.insert(robot);
        changed.notify_all();
    }

    bool ask_reset(std_srvs::Empty::Request &, std_srvs::Empty::Response &) {
        std::unique_lock<std::mutex> lock(mutex);
        reset_asked = true;
        changed.notify_all();
        while (reset_asked && ros::ok())
            changed.wait_for(lock, POLL);
        return true;
    }

    void wait(const Stg::World *world) {
        if (world->SimTimeNow() % step_us != 0)
            return;
        std::unique_lock<std::mutex> lock(mutex);
        while (driven.size() < starts.size() && ros::ok()) {
            changed.wait_for(lock, POLL);
            if (reset_asked)
                reset();
        }
        driven.clear();
    }

    void reset() {
        for (auto &start : starts) {
            start.first->SetSpeed(0, 0, 0);
            start.first->SetPose(start.second);
            start.first->SetStall(false);
        }
        driven.clear();
        reset_asked = false;
        changed.notify_all();
    }

    const Stg::usec_t step_us;
    ros::NodeHandle node;
    ros::CallbackQueue resets;
    ros::AsyncSpinner spinner;
    ros::ServiceServer service;
    std::vector<ros::Subscriber> topics;
    Starts starts;
    std::mutex mutex;
    std::condition_variable changed;
    std::set<size_t> driven;
    bool reset_asked = false;
};

int begin(Stg::Model *model, void *lockstep) {
    static_cast<Lockstep *>(lockstep)->begin(model->GetWorld());
    return 1;  // once
}

}  // namespace

extern "C" int Init(Stg::Model *model, Stg::CtrlArgs *args) {
    double step_s = 0;
    if (std::sscanf(args->worldfile.c_str(), "%*s %lf", &step_s) != 1 || !(step_s > 0)) {
        std::fprintf(stderr, "lockstep: expected ctrl \"lockstep SECONDS\", above 0\n");
        return 1;
    }
    model->AddCallback(Stg::Model::CB_UPDATE, begin, new Lockstep(Stg::usec_t(step_s * 1e6 + 0.5)));
    model->Subscribe();  // a model without subscribers is not updated
    return 0;
}
