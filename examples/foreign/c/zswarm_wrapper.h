/* Wrapper for zswarm simulators in C: the protocol of zswarm's docs/foreign.md on standard input and output.

   Fill in a struct zswarm_simulator and call zswarm_serve with it. The wrapper computes networks of the kind fully-meshed
   (zswarm_network.h), so that a trial is one message in each direction. For other kinds zswarm decides turn by turn. Output of
   printf goes to standard error. Needs POSIX; compile with -std=c11 -D_POSIX_C_SOURCE=200809L. */

#ifndef ZSWARM_WRAPPER_H
#define ZSWARM_WRAPPER_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "zswarm_network.h"

#define ZSWARM_VERSION 1
#define ZSWARM_LONGEST (8 << 20) /* bytes of a message */

enum zswarm_type { ZSWARM_INT, ZSWARM_FLOAT, ZSWARM_BOOL, ZSWARM_TEXT };

struct zswarm_setting {
    const char *name;
    enum zswarm_type type;
    double number;               /* of an int, float or bool: the default; after setup the experiment's value */
    char text[100];              /* the same of a text */
    double minimum, maximum;     /* limits of an int or float; both 0: none */
    const char *const *choices;  /* allowed texts, ended by NULL; NULL: any text */
    const char *description;
};

struct zswarm_simulator {
    const char *description; /* the reference; its first line is a summary */
    struct zswarm_setting *settings;
    int settings_count;
    const char *const *metrics, *const *sensors, *const *actuators; /* each ended by NULL; NULL: none */

    /* setup may set the following. */
    int inputs, outputs, agents;
    int participants;  /* genomes that play one trial together; 0 means one */
    const int *owners; /* for each agent the participant that drives it; NULL: the first drives all */
    int64_t first_seed; /* seed of the first trial, later ones count up; -1: any */

    const char *(*setup)(void);                         /* apply the settings; return NULL, or why they are refused */
    void (*reset)(uint64_t seed);                       /* begin a trial; the same seed gives the same trial */
    int (*turn)(int *agents);                           /* next turn: write the acting agents, return their number; 0: over */
    void (*observe)(int agent, float *observation);     /* write the observation of an agent of the turn */
    void (*act)(int agent, const float *action);        /* apply its action; called after all agents of the turn have observed */
    void (*judge)(double *fitness, double *metrics);    /* write one fitness per participant, and all metrics */
};

/* ---- messages out */

static struct { unsigned char *bytes; size_t size, room; } zswarm__out;
static int zswarm__pipe;

static void zswarm__fail(const char *why) {
    fprintf(stderr, "%s\n", why);
    exit(1);
}

static void *zswarm__memory(void *old, size_t size) {
    void *memory = realloc(old, size ? size : 1);
    if (!memory) zswarm__fail("no memory is left");
    return memory;
}

static void zswarm__put(const void *bytes, size_t size) {
    if (zswarm__out.size + size > zswarm__out.room) {
        zswarm__out.room = 2 * (zswarm__out.size + size);
        zswarm__out.bytes = zswarm__memory(zswarm__out.bytes, zswarm__out.room);
    }
    memcpy(zswarm__out.bytes + zswarm__out.size, bytes, size);
    zswarm__out.size += size;
}

static void zswarm__head(unsigned char code, uint64_t number, int bytes) { /* big-endian, as in msgpack */
    unsigned char head[9] = {code};
    for (int i = 0; i < bytes; i++) head[1 + i] = (unsigned char)(number >> 8 * (bytes - 1 - i));
    zswarm__put(head, 1 + (size_t)bytes);
}

static void zswarm__map(uint32_t fields) { zswarm__head(0xdf, fields, 4); }
static void zswarm__array(uint32_t items) { zswarm__head(0xdd, items, 4); }
static void zswarm__nil(void) { zswarm__head(0xc0, 0, 0); }
static void zswarm__bool(int value) { zswarm__head(value ? 0xc3 : 0xc2, 0, 0); }
static void zswarm__int(int64_t value) { zswarm__head(0xd3, (uint64_t)value, 8); }

static void zswarm__float(double value) {
    uint64_t bits;
    memcpy(&bits, &value, 8);
    zswarm__head(0xcb, bits, 8);
}

static void zswarm__text(const char *text) {
    zswarm__head(0xdb, strlen(text), 4);
    zswarm__put(text, strlen(text));
}

static void zswarm__floats(const float *numbers, size_t count) {
    zswarm__head(0xc6, 4 * count, 4);
    zswarm__put(numbers, 4 * count);
}

static uint32_t zswarm__count(const char *const *names) {
    uint32_t count = 0;
    while (names && names[count]) count++;
    return count;
}

static void zswarm__names(const char *key, const char *const *names) {
    zswarm__text(key);
    zswarm__array(zswarm__count(names));
    for (; names && *names; names++) zswarm__text(*names);
}

static void zswarm__begin(const char *type, uint32_t fields) {
    zswarm__out.size = 4; /* room for the length */
    if (!zswarm__out.room) zswarm__out.bytes = zswarm__memory(NULL, zswarm__out.room = 1024);
    zswarm__map(1 + fields);
    zswarm__text("type");
    zswarm__text(type);
}

static void zswarm__send(void) {
    const size_t length = zswarm__out.size - 4;
    for (int i = 0; i < 4; i++) zswarm__out.bytes[i] = (unsigned char)(length >> 8 * i);
    for (size_t sent = 0; sent < zswarm__out.size;) {
        const ssize_t some = write(zswarm__pipe, zswarm__out.bytes + sent, zswarm__out.size - sent);
        if (some <= 0) exit(1); /* the reader has gone */
        sent += (size_t)some;
    }
}

/* ---- messages in */

typedef const unsigned char *zswarm__at; /* a value within the message */
static zswarm__at zswarm__last;          /* end of the message */

static uint64_t zswarm__big(zswarm__at at, int bytes) {
    uint64_t number = 0;
    if (zswarm__last - at < bytes) zswarm__fail("a message is cut short");
    for (int i = 0; i < bytes; i++) number = number << 8 | at[i];
    return number;
}

/* Read a value's head: the number itself, or the length of other values, and where the content begins. */
static char zswarm__value(zswarm__at at, uint64_t *number, zswarm__at *content) {
    const int code = (int)zswarm__big(at, 1);
    int bytes = 0;
    char kind = '?';
    *number = 0;
    if (code < 0x80 || code >= 0xe0) kind = 'i', *number = (uint64_t)(int64_t)(signed char)code;
    else if (code < 0x90) kind = 'm', *number = code & 15;
    else if (code < 0xa0) kind = 'a', *number = code & 15;
    else if (code < 0xc0) kind = 's', *number = code & 31;
    else if (code == 0xc0) kind = 'n';
    else if (code == 0xc2 || code == 0xc3) kind = 'b', *number = code == 0xc3;
    else if (code >= 0xc4 && code <= 0xc6) kind = 's', bytes = 1 << (code - 0xc4);
    else if (code == 0xca || code == 0xcb) kind = code == 0xca ? 'f' : 'd', bytes = code == 0xca ? 4 : 8;
    else if (code >= 0xcc && code <= 0xd3) kind = 'i', bytes = 1 << ((code - 0xcc) & 3);
    else if (code >= 0xd9 && code <= 0xdb) kind = 's', bytes = 1 << (code - 0xd9);
    else if (code >= 0xdc && code <= 0xdd) kind = 'a', bytes = 2 << (code - 0xdc);
    else if (code >= 0xde) kind = 'm', bytes = 2 << (code - 0xde);
    else zswarm__fail("a message has a value of no known kind");
    if (bytes) *number = zswarm__big(at + 1, bytes);
    if (code >= 0xd0 && code <= 0xd2 && *number >> (8 * bytes - 1)) *number -= (uint64_t)1 << 8 * bytes; /* it is negative */
    *content = at + 1 + bytes;
    if (kind == 's' && (uint64_t)(zswarm__last - *content) < *number) zswarm__fail("a message is cut short");
    return kind;
}

static zswarm__at zswarm__behind(zswarm__at at) {
    uint64_t number;
    const char kind = zswarm__value(at, &number, &at);
    if (kind == 's') at += number;
    if (kind == 'm') number *= 2;
    if (kind == 'm' || kind == 'a')
        while (number--) at = zswarm__behind(at);
    return at;
}

static int zswarm__says(zswarm__at at, const char *text) {
    uint64_t length;
    return at && zswarm__value(at, &length, &at) == 's' && length == strlen(text) && !memcmp(at, text, length);
}

/* Return the value of a key of a map; NULL if the key is missing. */
static zswarm__at zswarm__field(zswarm__at map, const char *key) {
    uint64_t fields;
    if (!map || zswarm__value(map, &fields, &map) != 'm') return NULL;
    while (fields--) {
        const int found = zswarm__says(map, key);
        map = zswarm__behind(map);
        if (found) return map;
        map = zswarm__behind(map);
    }
    return NULL;
}

static uint64_t zswarm__whole(zswarm__at at) {
    uint64_t number = 0;
    if (!at || zswarm__value(at, &number, &at) != 'i') zswarm__fail("a message lacks a whole number");
    return number;
}

static double zswarm__number(zswarm__at at) {
    uint64_t bits;
    double number;
    const char kind = zswarm__value(at, &bits, &at);
    if (kind == 'd') return memcpy(&number, &bits, 8), number;
    if (kind != 'i' && kind != 'b') zswarm__fail("a message lacks a number");
    return (double)(int64_t)bits;
}

/* Return a bin of exactly this size; NULL for any other value. */
static zswarm__at zswarm__bytes(zswarm__at at, size_t expected) {
    uint64_t length;
    return at && zswarm__value(at, &length, &at) == 's' && length == expected ? at : NULL;
}

static int zswarm__read(void *bytes, size_t size) { return fread(bytes, 1, size, stdin) == size; }

/* ---- a simulator */

static struct zswarm_network zswarm__network;
static int zswarm__hosts; /* whether this program computes the networks */
static int *zswarm__agents, zswarm__acting; /* of the turn */
static float *zswarm__observations, *zswarm__actions, *zswarm__states, **zswarm__weights;
static double *zswarm__fitness, *zswarm__metrics;

static void zswarm__error(const char *why) {
    zswarm__begin("error", 1);
    zswarm__text("text");
    zswarm__text(why);
    zswarm__send();
}

static void zswarm__hello(const struct zswarm_simulator *simulator) {
    static const char *const types[] = {"int", "float", "bool", "text"};
    zswarm__begin("hello", 3);
    zswarm__text("v");
    zswarm__int(ZSWARM_VERSION);
    zswarm__text("description");
    zswarm__text(simulator->description);
    zswarm__text("settings");
    zswarm__array((uint32_t)simulator->settings_count);
    for (int i = 0; i < simulator->settings_count; i++) {
        const struct zswarm_setting *setting = simulator->settings + i;
        const int bounded = setting->minimum != 0 || setting->maximum != 0;
        zswarm__map(setting->choices || bounded ? (bounded ? 6 : 5) : 4);
        zswarm__text("name");
        zswarm__text(setting->name);
        zswarm__text("type");
        zswarm__text(types[setting->type]);
        zswarm__text("description");
        zswarm__text(setting->description ? setting->description : "");
        zswarm__text("default");
        if (setting->type == ZSWARM_INT) zswarm__int((int64_t)setting->number);
        if (setting->type == ZSWARM_FLOAT) zswarm__float(setting->number);
        if (setting->type == ZSWARM_BOOL) zswarm__bool(setting->number != 0);
        if (setting->type == ZSWARM_TEXT) zswarm__text(setting->text);
        if (setting->choices) zswarm__names("choices", setting->choices);
        if (bounded) {
            zswarm__text("minimum");
            setting->type == ZSWARM_INT ? zswarm__int((int64_t)setting->minimum) : zswarm__float(setting->minimum);
            zswarm__text("maximum");
            setting->type == ZSWARM_INT ? zswarm__int((int64_t)setting->maximum) : zswarm__float(setting->maximum);
        }
    }
    zswarm__send();
}

/* Return whether this program can compute networks of this kind. */
static int zswarm__host(const struct zswarm_simulator *simulator, zswarm__at network) {
    static const char *const activations[] = {"clamp", "sigmoid", "relu", "tanh"};
    if (!zswarm__says(zswarm__field(network, "kind"), "fully-meshed")) return 0;
    const zswarm__at settings = zswarm__field(network, "settings"), activation = zswarm__field(settings, "activation");
    int known = 0;
    while (known < 4 && !zswarm__says(activation, activations[known])) known++;
    zswarm__network.inputs = simulator->inputs;
    zswarm__network.outputs = simulator->outputs;
    zswarm__network.neurons = (int)zswarm__whole(zswarm__field(settings, "hidden")) + simulator->outputs;
    zswarm__network.iterations = (int)zswarm__whole(zswarm__field(settings, "iterations"));
    zswarm__network.activation = (enum zswarm_activation)known;
    return known < 4;
}

static void zswarm__setup(struct zswarm_simulator *simulator, zswarm__at message) {
    for (int i = 0; i < simulator->settings_count; i++) {
        struct zswarm_setting *setting = simulator->settings + i;
        const zswarm__at value = zswarm__field(zswarm__field(message, "settings"), setting->name);
        uint64_t length;
        zswarm__at text;
        if (!value) return zswarm__error("a setting is missing");
        if (setting->type != ZSWARM_TEXT) {
            setting->number = zswarm__number(value);
        } else {
            if (zswarm__value(value, &length, &text) != 's' || length >= sizeof setting->text)
                return zswarm__error("a setting is no text, or too long");
            memcpy(setting->text, text, length);
            setting->text[length] = 0;
        }
    }
    const char *refusal = simulator->setup();
    if (refusal) return zswarm__error(refusal);
    const size_t agents = (size_t)simulator->agents, participants = simulator->participants ? (size_t)simulator->participants : 1;
    zswarm__hosts = zswarm__host(simulator, zswarm__field(message, "network"));
    const size_t state = zswarm__hosts ? zswarm_network_state(&zswarm__network) : 0;
    for (size_t i = 0; zswarm__weights && zswarm__weights[i]; i++) free(zswarm__weights[i]);
    zswarm__weights = zswarm__memory(zswarm__weights, (participants + 1) * sizeof(float *));
    for (size_t i = 0; i < participants; i++)
        zswarm__weights[i] = zswarm__memory(NULL, zswarm__hosts ? 4 * zswarm_network_genes(&zswarm__network) : 0);
    zswarm__weights[participants] = NULL;
    zswarm__agents = zswarm__memory(zswarm__agents, agents * sizeof(int));
    zswarm__observations = zswarm__memory(zswarm__observations, 4 * agents * (size_t)simulator->inputs);
    zswarm__actions = zswarm__memory(zswarm__actions, 4 * agents * (size_t)simulator->outputs);
    zswarm__states = zswarm__memory(zswarm__states, 4 * agents * state);
    zswarm__fitness = zswarm__memory(zswarm__fitness, sizeof(double) * participants);
    zswarm__metrics = zswarm__memory(zswarm__metrics, sizeof(double) * zswarm__count(simulator->metrics));
    zswarm__acting = 0;

    zswarm__begin("ready", 9);
    zswarm__text("inputs");
    zswarm__int(simulator->inputs);
    zswarm__text("outputs");
    zswarm__int(simulator->outputs);
    zswarm__text("owners");
    zswarm__array((uint32_t)agents);
    for (size_t agent = 0; agent < agents; agent++) zswarm__int(simulator->owners ? simulator->owners[agent] : 0);
    zswarm__text("participants");
    zswarm__int((int64_t)participants);
    zswarm__names("metrics", simulator->metrics);
    zswarm__names("sensors", simulator->sensors);
    zswarm__names("actuators", simulator->actuators);
    zswarm__text("first_seed");
    simulator->first_seed < 0 ? zswarm__nil() : zswarm__int(simulator->first_seed);
    zswarm__text("hosts");
    zswarm__bool(zswarm__hosts);
    zswarm__send();
}

/* Begin the next turn and collect its observations. Return whether there is one. */
static int zswarm__next(const struct zswarm_simulator *simulator) {
    zswarm__acting = simulator->turn(zswarm__agents);
    for (int row = 0; row < zswarm__acting; row++)
        simulator->observe(zswarm__agents[row], zswarm__observations + row * simulator->inputs);
    return zswarm__acting > 0;
}

static void zswarm__act(const struct zswarm_simulator *simulator, const float *actions) {
    for (int row = 0; row < zswarm__acting; row++) simulator->act(zswarm__agents[row], actions + row * simulator->outputs);
}

static void zswarm__tell_end(const struct zswarm_simulator *simulator) {
    simulator->judge(zswarm__fitness, zswarm__metrics);
    const int participants = simulator->participants ? simulator->participants : 1;
    const uint32_t metrics = zswarm__count(simulator->metrics);
    zswarm__begin("end", 2);
    zswarm__text("fitness");
    zswarm__array((uint32_t)participants);
    for (int i = 0; i < participants; i++) zswarm__float(zswarm__fitness[i]);
    zswarm__text("metrics");
    zswarm__array(metrics);
    for (uint32_t i = 0; i < metrics; i++) zswarm__float(zswarm__metrics[i]);
    zswarm__send();
}

static void zswarm__tell_turn(const struct zswarm_simulator *simulator) {
    if (!zswarm__next(simulator)) return zswarm__tell_end(simulator);
    zswarm__begin("turn", 2);
    zswarm__text("agents");
    zswarm__array((uint32_t)zswarm__acting);
    for (int row = 0; row < zswarm__acting; row++) zswarm__int(zswarm__agents[row]);
    zswarm__text("observations");
    zswarm__floats(zswarm__observations, (size_t)zswarm__acting * (size_t)simulator->inputs);
    zswarm__send();
}

static void zswarm__evaluate(const struct zswarm_simulator *simulator, zswarm__at message) {
    uint64_t count;
    zswarm__at genome = zswarm__field(message, "genomes");
    const int participants = simulator->participants ? simulator->participants : 1;
    if (!zswarm__hosts || !genome || zswarm__value(genome, &count, &genome) != 'a' || count != (uint64_t)participants)
        return zswarm__error("evaluate: another network or number of genomes than it was set up with");
    for (uint64_t i = 0; i < count; i++, genome = zswarm__behind(genome)) {
        const zswarm__at bytes = zswarm__bytes(genome, 4 * zswarm_network_genes(&zswarm__network));
        if (!bytes) return zswarm__error("evaluate: a genome is of another length than the network's");
        zswarm_network_load(&zswarm__network, bytes, zswarm__weights[i]);
    }
    const size_t state = zswarm_network_state(&zswarm__network);
    memset(zswarm__states, 0, 4 * state * (size_t)simulator->agents);
    simulator->reset(zswarm__whole(zswarm__field(message, "seed")));
    while (zswarm__next(simulator)) {
        for (int row = 0; row < zswarm__acting; row++) {
            const int agent = zswarm__agents[row], owner = simulator->owners ? simulator->owners[agent] : 0;
            zswarm_network_decide(&zswarm__network, zswarm__weights[owner], zswarm__states + state * (size_t)agent,
                                  zswarm__observations + row * simulator->inputs, zswarm__actions + row * simulator->outputs);
        }
        zswarm__act(simulator, zswarm__actions);
    }
    zswarm__tell_end(simulator);
}

static void zswarm__actions_came(const struct zswarm_simulator *simulator, zswarm__at message) {
    const size_t size = 4 * (size_t)zswarm__acting * (size_t)simulator->outputs;
    const zswarm__at bytes = zswarm__bytes(zswarm__field(message, "actions"), size);
    if (!zswarm__acting || !bytes) return zswarm__error("actions: not those of the last turn");
    memcpy(zswarm__actions, bytes, size);
    zswarm__act(simulator, zswarm__actions);
    zswarm__tell_turn(simulator);
}

/* Serve until the input ends. Return the exit code for main. */
static int zswarm_serve(struct zswarm_simulator *simulator) {
    unsigned char *message = NULL, head[4];
    zswarm__pipe = dup(STDOUT_FILENO);
    dup2(STDERR_FILENO, STDOUT_FILENO); /* printf must not corrupt the messages */
    if (!zswarm_network_is_exact()) zswarm__fail("compile it with -ffp-contract=off: its networks would have other bits");
    zswarm__hello(simulator);
    while (zswarm__read(head, 4)) {
        const size_t length = head[0] | head[1] << 8 | head[2] << 16 | (size_t)head[3] << 24;
        if (length > ZSWARM_LONGEST) zswarm__fail("a message is too long");
        message = zswarm__memory(message, length);
        if (!zswarm__read(message, length)) break;
        zswarm__last = message + length;
        const zswarm__at type = zswarm__field(message, "type");
        if (zswarm__says(type, "setup")) {
            zswarm__setup(simulator, message);
        } else if (zswarm__says(type, "reset")) {
            simulator->reset(zswarm__whole(zswarm__field(message, "seed")));
            zswarm__tell_turn(simulator);
        } else if (zswarm__says(type, "actions")) {
            zswarm__actions_came(simulator, message);
        } else if (zswarm__says(type, "evaluate")) {
            zswarm__evaluate(simulator, message);
        } else {
            zswarm__error("no message that it knows");
        }
    }
    return 0;
}

#endif
