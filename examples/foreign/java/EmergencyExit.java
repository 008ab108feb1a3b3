import java.io.IOException;
import java.nio.file.Files;
import java.nio.file.Path;
import java.util.ArrayList;
import java.util.Arrays;
import java.util.List;
import java.util.Map;
import java.util.Random;

/** FREVO's emergency exit on a grid: a second implementation of zswarm's emergency-exit, from its reference. */
final class EmergencyExit extends SimulationWrapper {
    private record Place(int x, int y) {}

    private static final int[] NEIGHBOUR_X = {0, 1, 1, 1, 0, -1, -1, -1}; // from north clockwise; y grows downward
    private static final int[] NEIGHBOUR_Y = {-1, -1, 0, 1, 1, 1, 0, -1};
    private static final int OUT = -1; // all agents have left

    private int width;
    private int height;
    private int steps;
    private int agents;
    private int exits;
    private int blockades;
    private List<String> map; // of the stadium; null: a random field
    private List<Place> stadiumStarts;

    private boolean[][] free; // by y and x: not blocked and without an agent
    private List<Place> exitPlaces;
    private Place[][] nearest; // the way to the nearest exit
    private Place[] here;
    private boolean[] inside;
    private int round;
    private int agent;
    private int firstAllOut;
    private int remaining;

    private EmergencyExit() {
        setting("field", "random", List.of("random", "stadium"),
                "fields drawn from the trial's seed, or FREVO's stadium with 72 agents");
        setting("steps", 50, 1, 1_000_000, "rounds of a trial");
        setting("width", 20, 1, 1000, "cells of a random field");
        setting("height", 20, 1, 1000, "cells of a random field");
        setting("agents", 10, 1, 1000, "robots of a random field");
        setting("exits", 5, 1, 10_000, "exits of a random field");
        setting("blockades", 20, 0, 10_000, "blocked cells of a random field");
        setting("seed", 0, 0, (1L << 48) - 1, "of the first field; the trials have `seed`, `seed` + 1, ...");
    }

    public static void main(String[] arguments) throws IOException {
        new EmergencyExit().serve();
    }

    @Override
    protected String description() {
        return "Robots in a room must leave through the nearest exit; they block one another (in Java).\n\n"
                + "FREVO's EmergencyExit, as the simulator emergency-exit, of which the data sheet is.";
    }

    @Override
    protected List<String> metrics() {
        return List.of("escaped", "rounds");
    }

    @Override
    protected List<String> sensors() {
        return List.of("exit_dx", "exit_dy", "n", "ne", "e", "se", "s", "sw", "w", "nw");
    }

    @Override
    protected List<String> actuators() {
        return List.of("vx", "vy");
    }

    @Override
    protected World setup(Map<String, Object> settings) throws IOException {
        steps = number(settings, "steps");
        width = number(settings, "width");
        height = number(settings, "height");
        agents = number(settings, "agents");
        exits = number(settings, "exits");
        blockades = number(settings, "blockades");
        map = null;
        if (settings.get("field").equals("stadium")) {
            readStadium();
        } else if (width > height) {
            throw new IllegalArgumentException(
                    "width must not exceed height: a random field draws both coordinates from the width");
        } else if (agents + exits + blockades > width * width) {
            throw new IllegalArgumentException("agents, exits and blockades do not fit on width x width cells");
        }
        return new World(10, 2, agents, (Long) settings.get("seed"));
    }

    private static int number(Map<String, Object> settings, String name) {
        return ((Long) settings.get(name)).intValue();
    }

    /** Read the map, then the agents' cells in their order. */
    private void readStadium() throws IOException {
        List<String> words = Arrays.asList(Files.readString(Path.of("..", "stadium.txt")).trim().split("\\s+"));
        height = (int) words.stream().filter(word -> !word.contains(",")).count();
        map = words.subList(0, height);
        width = map.get(0).length();
        stadiumStarts = new ArrayList<>();
        for (String word : words.subList(height, words.size())) {
            String[] pair = word.split(",");
            stadiumStarts.add(new Place(Integer.parseInt(pair[0]), Integer.parseInt(pair[1])));
        }
        agents = stadiumStarts.size();
    }

    @Override
    protected Turn reset(long seed) {
        free = new boolean[height][width];
        for (boolean[] row : free) Arrays.fill(row, true);
        exitPlaces = new ArrayList<>();
        List<Place> starts = new ArrayList<>();
        if (map != null) {
            for (int y = 0; y < height; y++) {
                for (int x = 0; x < width; x++) {
                    if (map.get(y).charAt(x) == 'E') exitPlaces.add(new Place(x, y));
                    free[y][x] = map.get(y).charAt(x) != '#';
                }
            }
            starts = stadiumStarts;
        } else {
            Random random = new Random(seed);
            for (int i = 0; i < agents; i++) starts.add(take(random));
            for (int i = 0; i < exits; i++) exitPlaces.add(take(random));
            for (int i = 0; i < blockades; i++) take(random);
            for (Place place : exitPlaces) free[place.y][place.x] = true;
        }
        nearest = new Place[height][width];
        for (int y = 0; y < height; y++) for (int x = 0; x < width; x++) nearest[y][x] = wayOut(x, y);
        here = starts.toArray(new Place[0]);
        for (Place place : here) free[place.y][place.x] = false;
        inside = new boolean[agents];
        Arrays.fill(inside, true);
        round = 0;
        agent = OUT;
        firstAllOut = steps;
        remaining = agents;
        return next();
    }

    /** Draw a free cell and occupy it. */
    private Place take(Random random) {
        while (true) {
            int x = random.nextInt(width);
            int y = random.nextInt(width);
            if (free[y][x]) {
                free[y][x] = false;
                return new Place(x, y);
            }
        }
    }

    private Place wayOut(int x, int y) {
        Place best = null;
        int least = Integer.MAX_VALUE;
        for (Place exit : exitPlaces) { // the first of equals
            int dx = exit.x - x;
            int dy = exit.y - y;
            if (dx * dx + dy * dy < least) {
                least = dx * dx + dy * dy;
                best = new Place(dx, dy);
            }
        }
        return best;
    }

    @Override
    protected Turn step(float[][] actions) {
        int x = here[agent].x + velocity(actions[0][0]);
        int y = here[agent].y + velocity(actions[0][1]);
        if (isFree(x, y)) {
            free[here[agent].y][here[agent].x] = true;
            here[agent] = new Place(x, y);
            if (nearest[y][x].x == 0 && nearest[y][x].y == 0) {
                inside[agent] = false;
                if (--remaining == 0) firstAllOut = round;
            } else {
                free[y][x] = false;
            }
        }
        return next();
    }

    private static int velocity(float output) {
        float moved = 2 * output - 1;
        if (moved >= 0.5f && moved < 1.5f) return 1;
        return moved < -0.5f && moved >= -1.5f ? -1 : 0;
    }

    private boolean isFree(int x, int y) {
        return x >= 0 && x < width && y >= 0 && y < height && free[y][x];
    }

    /** Return the next agent that is inside, round by round. */
    private Turn next() {
        for (; round < steps && remaining > 0; round++, agent = OUT) {
            while (++agent < agents) {
                if (inside[agent]) return new Turn(new int[] {agent}, new float[][] {observe()});
            }
        }
        return null;
    }

    private float[] observe() {
        Place place = here[agent];
        float[] observation = new float[10];
        observation[0] = nearest[place.y][place.x].x;
        observation[1] = nearest[place.y][place.x].y;
        for (int i = 0; i < 8; i++) observation[2 + i] = isFree(place.x + NEIGHBOUR_X[i], place.y + NEIGHBOUR_Y[i]) ? 1 : 0;
        return observation;
    }

    @Override
    protected Outcome outcome() {
        double distances = 0;
        for (Place place : here) {
            double x = nearest[place.y][place.x].x;
            double y = nearest[place.y][place.x].y;
            distances += Math.sqrt(x * x + y * y);
        }
        double fitness = (double) (steps - firstAllOut) / steps - distances;
        return new Outcome(new double[] {fitness}, new double[] {agents - remaining, Math.min(firstAllOut + 1, steps)});
    }
}
