/* From messages to what @{name} observes, and from what it decides to velocities: the functions with which it was evolved. */
#ifndef INTERFACE_H
#define INTERFACE_H

@{includes}
@{declarations}
#endif
