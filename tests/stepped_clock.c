/* Preloaded into a process under test: its CLOCK_REALTIME is off by what stands in the file STEPPED_CLOCK names
 * (int64, ns), which the test may change at any time. Every other clock is left alone: the machine's own clock is never
 * touched, and nothing but this process is told another time.
 *
 * The kernel is not told either, and it ends waits: a deadline on the stepped clock is given to it on its own. Otherwise
 * the middleware's timers never end on a clock an hour ahead, and on one an hour behind they spin. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define NS 1000000000
#define FIRST_DATE 1000000000 /* s: no clock that counts from a machine's start has come so far */

static int (*real_gettime)(clockid_t, struct timespec *);
static int (*real_cond_timedwait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
static int (*real_mutex_timedlock)(pthread_mutex_t *, const struct timespec *);
static int (*real_sem_timedwait)(sem_t *, const struct timespec *);
static const volatile int64_t *step_ns;

__attribute__((constructor)) static void prepare(void)
{
	real_gettime = dlsym(RTLD_NEXT, "clock_gettime");
	real_cond_timedwait = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
	real_mutex_timedlock = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
	real_sem_timedwait = dlsym(RTLD_NEXT, "sem_timedwait");
	int file = open(getenv("STEPPED_CLOCK"), O_RDONLY | O_CLOEXEC);
	void *mapped = mmap(NULL, sizeof *step_ns, PROT_READ, MAP_SHARED, file, 0);
	if (file < 0 || mapped == MAP_FAILED)
		abort();
	close(file);
	step_ns = mapped;
}

static struct timespec moved(struct timespec time, int64_t by_ns)
{
	int64_t ns = time.tv_nsec + by_ns % NS;
	time.tv_sec += by_ns / NS + (ns >= NS) - (ns < 0);
	time.tv_nsec = ns + (ns < 0 ? NS : 0) - (ns >= NS ? NS : 0);
	return time;
}

/* A condition's deadline may be on CLOCK_MONOTONIC, which nobody steps. */
static struct timespec of_the_kernel(const struct timespec *deadline)
{
	if (!real_gettime)
		prepare();
	return moved(*deadline, deadline->tv_sec < FIRST_DATE ? 0 : -*step_ns);
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
	if (!real_gettime)
		prepare();
	int result = real_gettime(clock, now);
	if (result == 0 && clock == CLOCK_REALTIME)
		*now = moved(*now, *step_ns);
	return result;
}

int pthread_cond_timedwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
			   const struct timespec *restrict deadline)
{
	struct timespec until = of_the_kernel(deadline);
	return real_cond_timedwait(condition, mutex, &until);
}

int pthread_mutex_timedlock(pthread_mutex_t *restrict mutex, const struct timespec *restrict deadline)
{
	struct timespec until = of_the_kernel(deadline);
	return real_mutex_timedlock(mutex, &until);
}

int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict deadline)
{
	struct timespec until = of_the_kernel(deadline);
	return real_sem_timedwait(semaphore, &until);
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
	(void)zone;
	struct timespec stepped;
	int result = clock_gettime(CLOCK_REALTIME, &stepped);
	now->tv_sec = stepped.tv_sec;
	now->tv_usec = stepped.tv_nsec / 1000;
	return result;
}

time_t time(time_t *now)
{
	struct timespec stepped;
	clock_gettime(CLOCK_REALTIME, &stepped);
	if (now)
		*now = stepped.tv_sec;
	return stepped.tv_sec;
}
